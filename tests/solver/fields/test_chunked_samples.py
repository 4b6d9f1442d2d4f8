"""Samples in a file as a field: equal to the samples in memory, opened by every process, and what is refused."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
import zarr

import equimesh as em
from equimesh import specs
from equimesh.errors import SamplesError
from equimesh.fields import chunked_samples
from equimesh.fields.noise import noise_share
from equimesh.testing import check_field

X, Y = np.linspace(0, 1, 90) ** 1.2, np.linspace(0, 1, 70)
VALUES = np.tanh(12 * (X[:, None] - Y**2))
NAMES = ("u.zarr", "u.h5", "u.npz")


def write(path: Path, x: np.ndarray = X, y: np.ndarray = Y, values: np.ndarray = VALUES) -> Path:
    arrays = {"x": x, "y": y, "values": values}
    if path.suffix == ".zarr":
        group = zarr.create_group(path)
        for name, array in arrays.items():
            group.create_array(name, data=array, chunks=tuple(min(16, n) for n in array.shape))
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file.create_dataset(name, data=array, chunks=tuple(min(16, n) for n in array.shape))
    else:
        np.savez(path, **arrays)
    return path


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several tiles of few samples."""
    monkeypatch.setattr(chunked_samples, "TILE", 40)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_the_spline_through_all_samples(tmp_path: Path, name: str) -> None:
    chunked = em.ChunkedSamples(path=write(tmp_path / name))
    whole = em.GridSamples(x=X, y=Y, values=VALUES)
    points = np.random.default_rng(1).random((2, 500))
    for found, expected in zip(chunked.evaluate(*points, 2), whole.evaluate(*points, 2), strict=True):
        assert np.abs(found - expected).max() <= 3e-14 * np.abs(expected).max()
    check_field(chunked)
    assert (chunked.shape, chunked.box) == ((90, 70), ((0.0, 1.0), (0.0, 1.0)))
    np.testing.assert_array_equal(chunked.x, X)
    np.testing.assert_array_equal(chunked.y, Y)
    assert noise_share(chunked) == noise_share(whole)


def test_a_solve_gives_the_same_mesh_and_warnings(tmp_path: Path) -> None:
    values = np.sign(X[:, None] - 0.5) + 0.01 * np.random.default_rng(2).standard_normal((90, 70))
    chunked = em.ChunkedSamples(path=write(tmp_path / "u.npz", values=values))
    whole = em.GridSamples(x=X, y=Y, values=values)
    found, expected = (
        em.solve(
            em.Problem(monitor=em.Smoothed(monitor=em.ArcLength(u=u), radius=0.1), grid=em.Grid(n_xi=17, n_eta=17))
        )
        for u in (chunked, whole)
    )
    assert found.mesh.distance(expected.mesh) < 1e-12
    assert found.certificate.warnings == expected.certificate.warnings
    assert {text.partition(" of u ")[2][:10] for text in found.certificate.warnings} >= {"have noise", "change by "}


def test_axes_may_be_given_or_uniform(tmp_path: Path) -> None:
    np.save(tmp_path / "u.npy", VALUES)
    point = np.array(0.3), np.array(0.4)
    given = em.ChunkedSamples(path=tmp_path / "u.npy", x=X, y=Y)
    assert abs(given.evaluate(*point)[0] - em.GridSamples(x=X, y=Y, values=VALUES).evaluate(*point)[0]) < 1e-14
    box = ((0.0, 2.0), (-1.0, 1.0))
    uniform = em.ChunkedSamples(path=tmp_path / "u.npy", box=box)
    assert (uniform.x[[0, -1]].tolist(), uniform.y[[0, -1]].tolist()) == ([0, 2], [-1, 1])
    with h5py.File(tmp_path / "u.h5", "w") as file:
        file["a"], file["b"], file["u"] = X, Y, VALUES
    named = em.ChunkedSamples(path=tmp_path / "u.h5", x="a", y="b", values="u")
    assert named.evaluate(*point)[0] == given.evaluate(*point)[0]


@pytest.mark.parametrize("name", NAMES)
def test_a_path_is_pickled_and_no_samples(tmp_path: Path, name: str) -> None:
    chunked = em.ChunkedSamples(path=write(tmp_path / name))
    point = np.array([0.3, 0.9]), np.array([0.4, 0.1])
    expected = chunked.evaluate(*point, 1)
    sent = pickle.dumps(chunked)
    assert len(sent) < 1000
    np.testing.assert_array_equal(pickle.loads(sent).evaluate(*point, 1), expected)


def test_a_forked_process_opens_the_file_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chunked = em.ChunkedSamples(path=write(tmp_path / "u.h5"))
    before = chunked._here()
    assert chunked._here() is before
    # Only for this module: threads of other tests ask for their process, too.
    monkeypatch.setattr(chunked_samples, "os", SimpleNamespace(getpid=lambda: os.getpid() + 1))
    assert chunked._here() is not before


def test_a_process_that_does_not_reach_the_file_says_so(tmp_path: Path) -> None:
    sent = pickle.dumps(em.ChunkedSamples(path=write(tmp_path / "u.h5")))
    (tmp_path / "u.h5").rename(tmp_path / "v.h5")
    with pytest.raises(SamplesError, match=r"there is no file .*u.h5 on .*: check its name; .* all workers reach"):
        pickle.loads(sent).evaluate(np.array(0.5), np.array(0.5))
    write(tmp_path / "u.h5", X[:50], Y, VALUES[:50])
    with pytest.raises(SamplesError, match=r"has shape \(50, 70\) in this process, and had \(90, 70\)"):
        pickle.loads(sent).evaluate(np.array(0.5), np.array(0.5))


def test_bad_samples_are_refused_where_they_are_named(tmp_path: Path) -> None:
    spoiled = VALUES.copy()
    spoiled[61, 3] = np.nan
    for number, (arrays, reason) in enumerate(
        (
            ((X, Y, spoiled), r"values\[61\]\[3\] is NaN"),
            ((X, Y[:-1], VALUES), r"values has shape \(90, 70\), but x has 90 points and y has 69"),
            ((Y, X, VALUES), "transpose it"),
            ((X[::-1], Y, VALUES), "the axis decreases"),
            ((0.5 * X, Y, VALUES), "x reaches from 0 to 0.5, but the samples must cover"),
            ((X, Y, VALUES + 0j), "holds complex128: only real numbers"),
            ((X, Y, VALUES[0]), r"has shape \(70,\): it must have 2 dimensions"),
        )
    ):
        path = write(tmp_path / f"{number}.npz", *arrays)
        with pytest.raises(SamplesError, match=reason):
            em.ChunkedSamples(path=path)
    with pytest.raises(SamplesError, match="has no array 'u'; it has values, x, y"):
        em.ChunkedSamples(path=write(tmp_path / "u.npz"), values="u")


def test_a_problem_file_names_samples_that_stay_in_their_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "u.zarr")
    write(tmp_path / "u.h5", 2 * X, Y)
    document = {"grid": {"n_xi": 9, "n_eta": 9}, "monitor": {"kind": "arc_length", "u": {"samples": "u.zarr"}}}
    problem = specs.build(document, specs.samples_in(tmp_path)).problem
    assert isinstance(problem.monitor.u, em.ChunkedSamples)
    document |= {"domain": {"kind": "rectangle", "x": [0, 2], "y": [0, 1]}}
    document["monitor"] = {"kind": "arc_length", "u": {"samples": "u.h5"}}
    u = specs.build(document, specs.samples_in(tmp_path)).problem.monitor.u
    assert u.box == ((0.0, 2.0), (0.0, 1.0))
    np.save(tmp_path / "u.npy", VALUES)
    document["monitor"] = {"kind": "arc_length", "u": {"samples": "u.npy"}}
    assert isinstance(specs.build(document, specs.samples_in(tmp_path)).problem.monitor.u, em.GridSamples)
    monkeypatch.setattr("equimesh.specs.monitors.MAX_BYTES", 1000)
    assert isinstance(specs.build(document, specs.samples_in(tmp_path)).problem.monitor.u, em.ChunkedSamples)
    document["monitor"] = {"kind": "arc_length", "u": {"samples": "none.zarr"}}
    with pytest.raises(SamplesError, match="there is no file"):
        specs.build(document, specs.samples_in(tmp_path))
