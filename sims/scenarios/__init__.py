"""Default scenarios, `<experiment>.yaml`, where they differ from their schema's defaults."""
