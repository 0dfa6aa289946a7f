"""What NI-DAQmx refuses, and in which words."""

# What NI-DAQmx says; the numbers are those of nidaqmx.error_codes.
_TEXTS = {
    -50103: "The specified resource is reserved. The operation could not be completed as "
    "specified.",
    -200077: "Requested value is not a supported value for this property. The property value may "
    "be invalid because it conflicts with another property.",
    -200082: "Minimum is greater than or equal to the maximum.",
    -200088: "Task specified is invalid or does not exist.",
    -200089: "Task name specified conflicts with an existing task name.",
    -200099: "Physical channel not specified.",
    -200147: "Multiple counters specified when creating a counter input channel in a task.",
    -200170: "Physical channel specified does not exist on this device. Refer to the "
    "documentation for channels available on this device.",
    -200197: "Property specified is not supported.",
    -200220: "Device identifier is invalid.",
    -200430: "I/O type of the physical channel is not the one required.",
    -200489: "Specified channel cannot be added to the task, because a channel with the same name "
    "is already in the task.",
    -200498: "Syntax for a range of objects in the input string is invalid.",
    -200524: "Number of channels in the data does not match the number of channels in the task.",
    -200561: "Attempted writing analog data that is too large or too small.",
    -200587: "Specified lines are reserved by another task or unavailable.",
    -200846: "Write cannot be performed when the auto start input is false and the task is not "
    "running.",
}


class NiRefusal(Exception):
    """What NI-DAQmx refuses.

    Attributes:
        code: number of the error.
        text: its description.
    """

    def __init__(self, code: int, **details: object):
        self.code = code
        lines = "".join(f"\n{name.replace('_', ' ')}: {value}" for name, value in details.items())
        self.text = f"{_TEXTS[code]}{lines}\n\nStatus Code: {code}"
        super().__init__(self.text)
