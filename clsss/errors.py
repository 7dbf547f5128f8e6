"""The two errors a caller can meet: bad input, and a machine that cannot do the work."""


class InputError(ValueError):
    """Something the user gave is wrong; the message names it, says what is wrong and what to do."""


class DeviceError(RuntimeError):
    """The machine cannot do the work: no OpenCL device, too little memory, a failed build."""
