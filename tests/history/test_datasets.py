"""Histories as data sets: xarray and Zarr show what records and events hold, under names of CF and UGRID."""

import numpy as np
import pytest
from plain import plain_params

import warpriver as wr

xarray = pytest.importorskip("xarray")


@pytest.fixture(scope="module")
def history():
    # A sine-generated curve whose necks are about to close.
    heading = 2.0 * np.sin(2.0 * np.pi * np.arange(0.0, 7000.0, 40.0) / 1000.0)
    loop = 40.0 * np.cumsum(np.stack([np.cos(heading), np.sin(heading)], axis=1), axis=0)
    t = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    ring = np.stack([2000.0 + 500.0 * np.cos(t), 4000.0 + 500.0 * np.sin(t)], axis=1)
    network = wr.RiverNetwork.from_polylines(
        [loop, ring], width=[np.linspace(60.0, 70.0, len(loop)), np.full(len(ring), 80.0)], closed=[False, True]
    )
    return wr.Simulation(network, plain_params(), threads=1).run(years=12, record_every=10)


def test_records_are_those_of_the_history(history):
    data = history.to_xarray(every=2)
    kept = sorted({*range(0, len(history), 2), len(history) - 1})
    np.testing.assert_array_equal(data.time, history.times[kept])
    for place, k in enumerate(kept):
        network, own = history.networks[k], (data.node_record == place).values
        np.testing.assert_array_equal(np.stack([data.node_x, data.node_y], axis=1)[own], network.points())
        np.testing.assert_array_equal(data.node_width.values[own], np.concatenate(network.point_widths()))
        assert own.sum() == data.record_nodes[place] == network.point_count
        edges = data.edge_nodes.values[data.edge_record.values == place]
        ends = np.stack([data.node_x, data.node_y], axis=1)[edges]
        # A ring has a segment more than a line: the one that closes it.
        assert len(edges) == network.point_count - 1
        length = np.hypot(*(ends[:, 1] - ends[:, 0]).T).sum()
        assert length == pytest.approx(network.channel_lengths().sum())
        assert np.isin(edges, np.flatnonzero(own)).all()


def test_events_have_their_sections(history):
    data = history.to_xarray()
    cutoffs = list(history.cutoffs)
    assert len(cutoffs) > 0
    start = np.concatenate([[0], np.cumsum(data.event_points)])
    meanings = data.event_kind.attrs["flag_meanings"].split()
    for k, event in enumerate(history.events):
        assert meanings[int(data.event_kind[k])] == event.kind and float(data.event_time[k]) == event.time
        along = slice(int(start[k]), int(start[k + 1]))
        np.testing.assert_array_equal(data.event_x.values[along], event.xy[:, 0])
        np.testing.assert_array_equal(data.event_point_width.values[along], event.section[:, 0])
        assert float(data.event_depth[k]) == event.depth > 0.0 and event.discharge > 0.0
        assert event.section[0].tolist() == [event.width, event.depth]


def test_a_zarr_store_opens_without_us(history, tmp_path):
    pytest.importorskip("zarr")
    history.to_zarr(tmp_path / "run.zarr")
    data = xarray.open_zarr(tmp_path / "run.zarr", consolidated=False)
    assert data.equals(history.to_xarray()) and data.attrs["Conventions"] == "CF-1.11 UGRID-1.0"
    mesh = data.network.attrs
    assert mesh["cf_role"] == "mesh_topology" and mesh["topology_dimension"] == 1
    assert all(name in data for name in (*mesh["node_coordinates"].split(), mesh["edge_node_connectivity"]))
    with pytest.raises(FileExistsError, match="not empty"):
        history.to_zarr(tmp_path / "run.zarr")


def test_events_of_runs_before_they_had_sections_are_read(history, tmp_path, monkeypatch):
    from warpriver.history import segments

    real = segments.event_fields
    new = ("depth", "discharge", "section")
    monkeypatch.setattr(segments, "event_fields", lambda cls: tuple(f for f in real(cls) if f.name not in new))
    history.save(tmp_path / "old.npz")
    monkeypatch.undo()
    again = wr.read_history(tmp_path / "old.npz")
    assert [e.depth for e in again.cutoffs] == [None] * len(again.cutoffs)
    np.testing.assert_array_equal(again.cutoffs[0].xy, history.cutoffs[0].xy)
    maps = wr.landscape_maps(again, cell_size=40.0)
    assert (maps.ground.numpy() == wr.landscape.GROUND.index("oxbow lake")).any()
