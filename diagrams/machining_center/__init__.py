"""The machining centres: scenario, plants, controller, declaration."""
