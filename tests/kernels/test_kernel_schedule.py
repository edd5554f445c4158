"""Sub-steps of migration: how many each channel needs and which of them it takes, against the twins in reference.py."""

import math

import numpy as np
import pytest
import reference
import warp as wp
from kernel_arrays import (
    REALS,
    SCALARS,
    UNWRITTEN,
    channels_of,
    going_on,
    status_of,
    struct_of,
    structs,
    to_device,
    unwritten,
)

from warpriver.kernels import schedule
from warpriver.kernels.channels import Stems
from warpriver.kernels.status import CONTACTS, DONE, FAULT, GOAL, HALT, STEPS, SUBSTEPS, TOUCH


def planned(limit, max_speed, mobility, time_step, dtype, device, before=0):
    """Parts of each channel's time step, and the most of them, ``before`` at least."""
    scalar = SCALARS[dtype]
    kernel = schedule.build(scalar)
    mobility, max_speed = (
        None if v is None else to_device(np.array(v, np.float64), scalar, device) for v in (mobility, max_speed)
    )
    limits = structs(np.transpose(limit), kernel.Limits, device)
    parts, most = unwritten(len(limit), wp.int32, device), to_device([before], wp.int32, device)
    inputs = [limits, time_step, to_device([0, 1, 0], wp.int32, device), going_on(device), mobility, max_speed]
    wp.launch(kernel.plan_steps, dim=len(limit), inputs=inputs, outputs=[parts, most], device=device)
    return parts.numpy().tolist(), int(most.numpy()[0])


@pytest.mark.parametrize(
    ("status", "contacts", "halts"),
    [
        ({}, 0, False), ({DONE: 3, STEPS: 2}, 0, False), ({}, 2, False), ({DONE: 3}, 2, TOUCH), ({FAULT: 1}, 0, True),
        ({HALT: 1, DONE: 2}, 0, True), ({DONE: 3, STEPS: 3}, 0, True),
    ],
)  # fmt: skip
@pytest.mark.parametrize("planned", [0, 1])
def test_faults_contacts_and_the_goal_halt_what_is_to_follow(device, status, contacts, halts, planned):
    """Contacts that the host knows of, from before the first sub-step of a row, do not; halted, nothing changes."""
    kernel = schedule.build(wp.float64)
    state = status_of({GOAL: 3, CONTACTS: contacts} | status, device)
    substep, most = to_device([0, 2, planned], wp.int32, device), to_device([4], wp.int32, device)
    mobility, max_speed = (to_device(np.full(3, 0.5), wp.float64, device) for _ in range(2))
    wp.launch(kernel.begin_substep, dim=3, inputs=[substep], outputs=[mobility, most, state], device=device)
    assert state.numpy()[HALT] == halts
    assert (mobility.numpy() == (0.5 if halts or planned else 0.0)).all()
    assert most.numpy()[0] == (4 if halts or planned else 0)
    parts = unwritten(3, wp.int32, device)
    limits = structs(np.full((3, 3), 10.0), kernel.Limits, device)
    inputs, outputs = [limits, 0.3, substep, state, mobility, max_speed], [parts, most]
    wp.launch(kernel.plan_steps, dim=3, inputs=inputs, outputs=outputs, device=device)
    if halts or planned:
        assert (parts.numpy() == UNWRITTEN).all() and most.numpy()[0] == 4
        parts = to_device([1, 2, 4], wp.int32, device)
    out, outputs = unwritten(3, wp.float64, device), None
    outputs = [out, max_speed, substep, state]
    wp.launch(kernel.schedule_channels, dim=3, inputs=[parts, 0.3, most], outputs=outputs, device=device)
    if halts:
        assert np.isnan(out.numpy()).all() and (max_speed.numpy() == 0.5).all()
        assert substep.numpy().tolist() == [0, 2, planned]
    else:
        assert bool((out.numpy() > 0.0).all()) == bool(planned) and (max_speed.numpy() == 0.0).all()
        total = 4 if planned else 1
        assert substep.numpy().tolist() == [0, total, 1] and state.numpy()[SUBSTEPS] == total


def scheduled(parts, time_step, total, dtype, device):
    """Step of each channel in each sub-step, (total, C); the max speeds are cleared in the first."""
    scalar = SCALARS[dtype]
    kernel = schedule.build(scalar)
    steps = []
    for k in range(total):
        out, max_speed = unwritten(len(parts), scalar, device), to_device(np.ones(len(parts)), scalar, device)
        inputs, status = [to_device(parts, wp.int32, device), time_step, None], going_on(device)
        number = to_device([k, total, 1], wp.int32, device)
        wp.launch(
            kernel.schedule_channels,
            dim=len(parts),
            inputs=inputs,
            outputs=[out, max_speed, number, status],
            device=device,
        )
        assert (max_speed.numpy() == (k > 0)).all()
        steps.append(out.numpy())
        wp.launch(
            kernel.schedule_channels, dim=len(parts), inputs=inputs, outputs=[out, None, number, status], device=device
        )
    return np.array(steps)


def test_parts_of_a_step_match_the_twin(device, dtype):
    rng = np.random.default_rng(18)
    time_step, count = 0.29, 400
    limit = np.stack([*10.0 ** rng.uniform(-3.0, 1.0, (2, count)), rng.uniform(1.0, 90.0, count)], axis=1)
    max_speed, mobility = 10.0 ** rng.uniform(-3.0, 3.0, count), rng.uniform(0.0, 1.0, count)
    mobility[::7], limit[5::9] = 0.0, 0.0
    max_speed[3::11], limit[4::13, :2] = np.inf, np.inf
    for g in (mobility, None):
        twin = [
            reference.step_count(*row, v, 1.0 if g is None else g[c], time_step)
            for c, (row, v) in enumerate(zip(limit, max_speed, strict=True))
        ]
        assert planned(limit, max_speed, g, time_step, dtype, device) == (twin, max(twin))
        assert planned(limit, max_speed, g, time_step, dtype, device, before=max(twin) + 5)[1] == max(twin) + 5
        assert max(twin) > 50 and min(twin) == 0


def test_a_step_that_divides_evenly_is_not_divided_further(device, dtype):
    def parts(limit, max_speed, mobility=1.0, time_step=0.29):
        return planned([limit], [max_speed], [mobility], time_step, dtype, device)[0][0]

    for time_step in (0.29, 106.0 / 365.25, 3.0):
        for n in (1, 2, 3, 7, 10, 49, 333, 5000):
            for limit, max_speed in (
                ((np.inf, time_step / n, 9.0), 0.0),  # waves
                ((time_step / n, np.inf, 9.0), np.inf),  # the tightest bend
                ((0.0 * n + 1e-9, np.inf, 9.0), 4.5 * n / time_step),  # bends as they are: half a width a part
            ):
                assert parts(limit, max_speed, time_step=time_step) == n
                shorter = (limit[0] * (1.0 - 1e-5), limit[1] * (1.0 - 1e-5), limit[2])
                assert parts(shorter, max_speed * (1.0 + 1e-5), time_step=time_step) == n + 1
            assert parts((np.inf, 0.25 * time_step / n, 9.0), 0.0, 0.25, time_step) == n
    assert parts((np.inf, np.inf, 9.0), 0.0) == 1
    assert parts((1e-30, 1e-30, 9.0), np.inf) == 1_000_000
    assert parts((1e-30, 1e-30, 9.0), np.inf, 0.0) == parts((0.0, 0.0, 0.0), 0.0) == 0


@pytest.mark.parametrize("total", [1, 2, 3, 7, 12, 60, 97])
def test_every_channel_takes_its_own_sub_steps(device, dtype, total):
    """Of N sub-steps n for each n up to N, the first always, evenly spread, and together the time step."""
    time_step = 0.29
    asked = np.arange(total + 3)  # 0: held by the ground; of more than N only N are taken
    for steps in (scheduled(asked, time_step, total, dtype, device),):
        for n, column in zip(asked, steps.T, strict=True):
            parts = min(int(n), total)
            own = np.flatnonzero(column > 0.0)
            assert own.tolist() == reference.own_substeps(parts, total)
            assert (column[np.setdiff1d(np.arange(total), own)] == 0.0).all()
            if parts == 0:
                continue
            assert own[0] == 0 and set(np.diff([*own, total])) <= {total // parts, -(-total // parts)}
            assert (column[own] == column[0]).all()
            # The time step and its part are rounded once each.
            rounding = float(np.finfo(REALS[dtype]).eps)
            assert math.fsum(column[own].tolist()) == pytest.approx(time_step, rel=rounding)


@pytest.mark.parametrize(("planned", "halt"), [(0, 0), (1, 0), (0, 1)])
def test_links_of_a_stem_take_the_same_sub_steps(device, planned, halt):
    """The maximum of those that move at all, and only where the step is being planned."""
    kernel = schedule.build(wp.float64)
    parts = [3, 1, 0, 7, 2, 5]
    top = to_device(np.array([0, 1, 0, 1, 4, 0], np.int32), wp.int32, device)
    channels = channels_of(wp.float64, stems=struct_of(Stems, top=top))
    own, most = to_device(np.array(parts, np.int32), wp.int32, device), wp.zeros(6, dtype=int, device=device)
    status, substep = status_of({HALT: halt}, device), to_device([0, 1, planned], wp.int32, device)
    wp.launch(kernel.gather_stems, 6, [channels, substep, status, own], [most], device=device)
    wp.launch(kernel.level_stems, 6, [channels, substep, status, most], [own], device=device)
    assert own.numpy().tolist() == (parts if planned or halt else [5, 7, 0, 7, 2, 5])
