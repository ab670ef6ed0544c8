"""What can go wrong, in words for the person at the rig, with the exit status of CONTRACT 6."""


class EpsHilError(Exception):
    """Base of every error that a user may see; its text is one line."""

    exit_status = 1


class InputError(EpsHilError):
    """Something the user gave us is wrong: names the file, the place in it, and the remedy.

    ``place`` is a line, column, field or signal (may be empty when the whole file is meant).
    """

    exit_status = 2

    def __init__(self, file: object, place: str, problem: str, remedy: str = "") -> None:
        where = f"{file}: {place}" if place else f"{file}"
        text = f"{where}: {problem}" + (f"; {remedy}" if remedy else "")
        super().__init__(" ".join(text.split()))
        self.file, self.place, self.problem, self.remedy = str(file), place, problem, remedy

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str, str]]:
        """So that a worker process can hand it to whoever asked."""
        return type(self), (self.file, self.place, self.problem, self.remedy)


class BusError(EpsHilError):
    """The CAN bus refused what we need from it (no interface, an option refused, gone)."""


class AbsentBusError(BusError):
    """The interface is not there, or down: what is plugged in or set up later may mend it."""


class SafetyStop(EpsHilError):
    """A safety limit ended the run."""

    exit_status = 3
