"""Migration: how fast each point of a channel moves sideways, and the move itself."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from warpriver.arrays import DeviceArray
from warpriver.engine.phase import Phase
from warpriver.engine.stages import Share, Stage, clear, launch
from warpriver.engine.state import State
from warpriver.kernels import migration as kernels
from warpriver.meander.banks import BankField, highest_factor
from warpriver.meander.inlets import Inlets
from warpriver.meander.memory import StemMemory, migration_constants, rate_of
from warpriver.params import MeanderParams
from warpriver.public import public
from warpriver.validate import floats

__all__ = [
    "Migrate",
    "explicit_dt",
    "measure_rings",
    "rate_of",
    "stable_dt",
    "step_limits",
]


@public
def step_limits(width: npt.ArrayLike, depth: npt.ArrayLike, params: MeanderParams) -> tuple[Any, Any]:
    """Longest time steps in yr that follow a channel truly, (travel, carried); longer ones are done in equal parts.

    - the upstream term is explicit: a wave that it carries downstream must not outgrow the local term's diffusion,
      dt <= 1 / (D gamma^2 alpha^2), half the bound of an explicit step (D = k w |omega|, alpha = 2 f / d, or 1 / (L w)
      with a ``memory_length`` L);
    - a bend as tight as its width must move by less than its width: dt <= w / (k max(|omega|, gamma - |omega|)).
      Where no bend is as tight, it is enough that the fastest point moves by less than half a width.

    In the weakest banks the rate is greater by a factor: bends there keep to the second limit, waves to the bound of an
    explicit step, as they are soon carried out of them.

    The diffusion of the local term sets no limit: what of it would be unstable is treated implicitly. Small waves stay
    true up to 12 times this step and more, and no bend crosses itself in steps 16 times as long.

    Args:
        width: Channel width in m, a number or an array.
        depth: Channel depth in m, alike.
        params: Migration constants.

    Returns:
        Two time steps in yr, float64, of the arguments' shape; infinite where nothing moves.
    """
    width, depth = floats(width, "width"), floats(depth, "depth")
    weights = max(-params.local_weight, params.local_weight + params.upstream_weight)
    rate, highest = rate_of(width, params), highest_factor(params)
    with np.errstate(divide="ignore"):
        travel = width / (highest * rate * weights)
        memory = 1.0 / (params.memory_length * width) if params.memory_length else 2.0 * params.friction / depth
        # Without a local term nothing damps the waves; its own weight of 1 then stands in as the scale.
        diffusivity = rate * width * max(-params.local_weight, 1.0)
        carried = 1.0 / (max(1.0, 0.5 * highest) * diffusivity * (params.upstream_weight * memory) ** 2)
    return travel, carried


@public
def stable_dt(width: npt.ArrayLike, depth: npt.ArrayLike, params: MeanderParams) -> Any:
    """Longest time step in yr that follows a channel truly whatever its bends, the lesser of :func:`step_limits`.

    Args:
        width: Channel width in m, a number or an array.
        depth: Channel depth in m, alike.
        params: Migration constants.

    Returns:
        Time step in yr, float64, of the arguments' shape; infinite where nothing moves.
    """
    return np.minimum(*step_limits(width, depth, params))


def explicit_dt(width: Any, params: MeanderParams) -> Any:
    """Time step in yr up to which the local term is treated wholly explicitly: D dt / h^2 <= 9/32.

    Args:
        width: Channel width in m.
        params: Migration constants; ``spacing`` is h.
    """
    width = np.asarray(width, np.float64)
    diffusivity = rate_of(width, params) * width * -params.local_weight
    with np.errstate(divide="ignore"):
        return np.where(diffusivity > 0, 9.0 / 32.0 * params.spacing**2 / diffusivity, np.inf)


def measure_rings(state: State) -> list[Stage]:
    """Return the stages that measure ``state.area``, that of every active ring; none without rings.

    Args:
        state: Its points are evenly spaced along each channel.
    """
    area, channels = state.area, state.channels()
    if area is None:
        return []

    def forget(_: Share) -> None:
        clear(area)

    def measure(share: Share) -> None:
        launch(
            kernels.build(state.scalar).measure_rings,
            dim=share.point_threads,
            inputs=[channels, state.network.point_xy, share.work],
            outputs=[area],
            device=state.device,
        )

    return [Stage("migrate", forget, shared=False), Stage("migrate", measure)]


class Migrate(Phase):
    """Moves every point by its rate over ``state.step``, into ``state.point_moved``.

    Attributes:
        point_velocity: (P,) vec2, migration rate times the normal to the right of the flow, half smoothed, m/yr.
        memory: What the links of stems hand on; None where no phase follows stems.
        inlets: What enters at heads.
        banks: The strength of banks; None where all are alike.
    """

    name = "migrate"
    point_velocity: DeviceArray
    memory: StemMemory | None
    inlets: Inlets

    def __init__(self) -> None:
        self.banks: BankField | None = None

    def allocate(self, state: State) -> None:
        """Make the device arrays."""
        self.point_velocity = state.zeros(state.point_capacity, state.vec2)
        self.memory = None
        if state.stems is not None:
            self.memory = StemMemory(state.channel_capacity, state.scalar, state.device)
        if state.params.bank_spread > 0.0 and self.banks is None:
            self.banks = BankField(state.seed, state.device)
        self.inlets = Inlets(state)
        self.inlets.install(state)

    def install(self, state: State) -> None:
        """Take the channels' inlets."""
        self.inlets.install(state)

    def stages(self, state: State) -> list[Stage]:
        """Return the stages: areas of rings, velocities, what links hand on to each other, the move."""
        kernel, constants = kernels.build(state.scalar), migration_constants(state.params, state.network.dtype)
        channels, points, ground, moved = state.channels(), state.points(), state.ground(), state.moved()
        stems, memory = state.stems, self.memory
        self.inlets.give(channels)
        if self.banks is not None:
            ground.banks = self.banks.struct(state.params, state.network.dtype, state.network.origin)
        handed_on = memory.struct() if memory is not None and stems is not None and stems.joined else kernel.Memory()

        velocities = kernel.Velocities()
        velocities.point, velocities.tail = self.point_velocity, handed_on.tail

        def compute(share: Share) -> None:
            launch(
                kernel.compute_velocity,
                dim=share.point_threads,
                inputs=[channels, points, constants, share.work],
                outputs=[self.point_velocity, handed_on],
                device=state.device,
            )

        def move(share: Share) -> None:
            launch(
                kernel.move_points,
                dim=share.point_threads,
                inputs=[channels, points, ground, constants, share.work, velocities],
                outputs=[moved, state.max_speed_bits],
                device=state.device,
            )

        before = [*measure_rings(state), *self.inlets.stages(state)]
        if memory is None or stems is None or not stems.joined:
            return [*before, Stage("migrate", compute), Stage("migrate", move)]

        def measure(_: Share) -> None:
            memory.measure(channels, stems.length)

        def chain(whole: Share) -> None:
            memory.chain(channels, constants, whole.work)

        def add(share: Share) -> None:
            memory.add(channels, points, constants, share, self.point_velocity)

        def find_tails(whole: Share) -> None:
            memory.find_tails(channels, whole.work)

        return [
            *before,
            Stage("migrate", measure, shared=False),
            Stage("migrate", compute),
            Stage("migrate", chain, shared=False),
            Stage("migrate", add),
            Stage("migrate", find_tails, shared=False),
            Stage("migrate", move),
        ]

    def check(self, state: State) -> None:
        """Points are finite, and no end has moved but where a stem goes on, or leaves the map."""
        state.check_moved(self.name, anchored=True if state.stems is None else state.stems.holds_feet())
