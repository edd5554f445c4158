"""A stand-in for the history of a run, made by hand."""

import types

from warpriver.history import EventLog


class History(types.SimpleNamespace):
    """What pictures read of a history: times, networks and events; functions take it for one by its name.

    Where no ``events`` are given they are those of the kinds that are, in the order of time.
    """

    crs = None

    def __len__(self):
        return len(self.times)

    def __getattr__(self, name):
        if name != "events":
            raise AttributeError(name)
        given = [event for kind in ("cutoffs", "collisions", "avulsions") for event in vars(self).get(kind, ())]
        return EventLog(sorted(given, key=lambda event: event.time))
