"""Surveys of rivers that are known exactly: lines of a simulation at two times, as they are or as they are measured."""

import functools

import numpy as np
from plain import plain_params

import warpriver as wr

WIDTH = 100.0
# About those of surveyed rivers.
TRUE = {"migration_rate": 20.0, "memory_length": 2.5, "curvature_saturation": 0.2}
LAW = plain_params(**TRUE, sinuosity_scaling="none")


@functools.cache
def grown(length=12_000.0, years=480.0, seed=3, device="cpu"):
    """A river 100 m wide that has meandered for a while, sinuosity 1.8: its line."""
    line = wr.generate.noisy_line(length, 25.0, 50.0, seed)
    sim = wr.Simulation(wr.RiverNetwork.from_polylines([line], width=WIDTH, device=device), LAW)
    sim.run(years=years, record_every=10**6)
    return sim.network.polylines()[0]


def moved(line, years, law=LAW, controls=(), device="cpu", width=WIDTH):
    """The line after so many years, to the day, and the cutoffs on the way."""
    network = wr.RiverNetwork.from_polylines([line], width=width, device=device)
    steps = int(np.ceil(years / law.time_step))
    sim = wr.Simulation(network, law.replace(time_step=years / steps), controls=list(controls))
    sim.run(steps=steps, record_every=10**6)
    return sim.network.polylines()[0], sim.history.cutoffs


def measured(line, noise=0.0, seed=0, device="cpu", width=WIDTH):
    """A network of the line, each point off by so many metres."""
    off = noise * np.random.default_rng(seed).standard_normal(line.shape)
    return wr.RiverNetwork.from_polylines([line + off], width=width, crs="EPSG:32619", device=device)
