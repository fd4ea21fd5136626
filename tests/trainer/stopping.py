"""A run that stops by itself."""

from reference_trainer.runtime.progress import Progress

__all__ = ["StoppedError", "StopsAt"]


class StoppedError(Exception):
    pass


class StopsAt(Progress):
    """Stops a run after so many iterations."""

    def __init__(self, n):
        super().__init__()
        self.left = n

    def each(self, training):
        self.left -= 1
        if self.left < 0:
            raise StoppedError
