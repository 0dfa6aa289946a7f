"""Errors of the driver library, as faults of the card."""

import pytest
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.errors import DaqError

from parapod.systems.hardware.device import DeviceError, DeviceFault
from parapod.systems.hardware.ni.settings import NiDaqSettings
from parapod.systems.hardware.ni.tasks import NiTasks


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        (DAQmxErrors.PAL_TRANSFER_ABORTED, DeviceFault.UNPLUGGED),
        (DAQmxErrors.DEV_ABSENT_OR_UNAVAILABLE, DeviceFault.UNPLUGGED),
        (DAQmxErrors.DEV_CANNOT_BE_ACCESSED, DeviceFault.UNPLUGGED),
        (DAQmxErrors.OPERATION_TIMED_OUT, DeviceFault.SILENT),
        (DAQmxErrors.INVALID_ATTRIBUTE_VALUE, DeviceFault.FAILED),
    ],
    ids=lambda value: value.name,
)
def test_an_error_of_the_library_is_the_fault_that_its_name_says(monkeypatch, code, fault):
    tasks = NiTasks(NiDaqSettings(), "card")

    def identify():
        raise DaqError(f"the library says {code.name}", code.value)

    monkeypatch.setattr(tasks, "_identify", identify)
    with pytest.raises(DeviceError, match=f"card.*{code.name}") as caught:
        tasks.open()
    assert caught.value.fault is fault
