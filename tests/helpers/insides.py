"""What a simulation holds on the device, for tests that look inside or make room scarce."""

from warpriver.meander.cutoffs import CutOff
from warpriver.shortest_path.route import TakeShortcuts


def phase_of(sim, kind):
    """The phase of a simulation that is of a class."""
    (phase,) = [phase for phase in sim.stepper.phases if isinstance(phase, kind)]
    return phase


def loops_of(sim):
    """What a simulation cuts off, by whichever way."""
    return phase_of(sim, (CutOff, TakeShortcuts)).loops


def shortcuts_of(sim):
    """The shortcuts of a simulation by shortest paths."""
    return phase_of(sim, TakeShortcuts).shortcuts


def tighten(sim, cuts=1, points=4):
    """Leave room for the points that there are, and for so many cutoffs and points of theirs."""
    state = sim.stepper.state
    state.allocate_points(sim.network.point_count)
    loops_of(sim).reserve(state, cuts, points)


def on_launch(sim, note):
    """Call ``note(status, count)`` after each batch of sub-steps of a simulation."""
    launch = sim.stepper._launch

    def noted(count, steps):
        status = launch(count, steps)
        note(status, count)
        return status

    sim.stepper._launch = noted
