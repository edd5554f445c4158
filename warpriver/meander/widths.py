"""Widths that vary through bends, as the two banks of a channel move apart from each other."""

from __future__ import annotations

from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, launch
from warpriver.engine.state import State
from warpriver.kernels import widths as kernels
from warpriver.params import WidthParams

__all__ = ["Widen"]


class Widen(Phase):
    """Lets the inner bank of a bend follow the outer one with a lag, so that channels are wider where they migrate."""

    name = "widen"
    varies_sections = True

    def __init__(self, params: WidthParams) -> None:
        """Take how wide a channel may become."""
        self.widening = params.widest

    def allocate(self, state: State) -> None:
        """Nothing: it has no arrays of its own."""
        return None

    def stages(self, state: State) -> list[Stage]:
        """Return the stage that moves the banks of the points on their way."""
        kernel, params = kernels.build(state.scalar), state.params.widths
        widening = kernel.Widening()
        widening.lag, widening.time, widening.widest = params.lag, params.time, params.widest
        channels, points, moved = state.channels(), state.points(), state.moved()

        def widen(share: Share) -> None:
            inputs = [channels, points, widening, share.work]
            launch(kernel.widen_points, share.point_threads, inputs, [moved], state.device)

        return [Stage(self.name, widen)]

    def check(self, state: State) -> None:
        """Points are finite."""
        state.check_moved(self.name, anchored=False)
