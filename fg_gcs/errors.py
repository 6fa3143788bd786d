"""One tree of errors; the type says who is to blame."""


class FgError(Exception):
    """Base of every error this program raises on purpose; its text is one clear line for people."""


class MissionError(FgError):
    """The mission file, or what was asked for on the command line, is at fault."""


class PlanError(FgError):
    """Geometry or physics is at fault: no plan exists that keeps every limit."""


class VehicleError(FgError):
    """A vehicle refused, was lost, or did something it was not told to do."""


class LinkError(FgError):
    """The network is at fault: a port is taken, or no vehicle answers."""
