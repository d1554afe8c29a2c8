import itertools
import json

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import sealed, unsealed
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.rl.data import solved_layouts
from armctl.rl.data.solved_layouts import CARD, CLEARANCES, ObstacleLayoutSolver, SolvedLayouts, make, read
from armctl.tasks.reach import read_boxes

TOLERANCE = 0.05


@pytest.fixture(autouse=True)
def small_parts(monkeypatch):
    monkeypatch.setattr(solved_layouts, "PART", 5)


@pytest.fixture(scope="module")
def model():
    return ArmModel("ur5")


def made(folder, model, count=10, seed=0):
    make(folder, count, ObstacleLayoutSolver(model.description, TOLERANCE, seed), progress=False)
    return folder


def test_ways_are_free_and_lead_from_home_into_the_sphere(tmp_path, model):
    layouts = read(made(tmp_path, model))
    assert 8 <= len(layouts) <= 10
    for row in range(len(layouts)):
        way, boxes = layouts.way(row), read_boxes(layouts.boxes[row])
        np.testing.assert_allclose(way[0], model.home, atol=1e-6)
        assert np.linalg.norm(model.position(way[-1]) - layouts.targets[row]) <= TOLERANCE
        checker = EdgeChecker(ArmShapes(model), boxes, 0.9 * CLEARANCES[-1], way[0])
        assert all(checker.is_edge_free(a, b) for a, b in itertools.pairwise(way))


def test_seeds_draw_other_layouts_and_a_seed_the_same(tmp_path, model):
    first, again, other = (read(made(tmp_path / name, model, 5, seed)) for name, seed in (("a", 0), ("b", 0), ("c", 1)))
    np.testing.assert_array_equal(first.ways, again.ways)
    assert not set(map(tuple, first.targets.tolist())) & set(map(tuple, other.targets.tolist()))


def test_after_an_interrupt_the_rest_is_made(tmp_path, model, monkeypatch):
    whole = made(tmp_path / "whole", model)
    solve, asked = ObstacleLayoutSolver.solve, []

    def interrupted(self, number):
        asked.append(number)
        if number == 7 and asked.count(7) == 1:
            raise KeyboardInterrupt
        return solve(self, number)

    monkeypatch.setattr(ObstacleLayoutSolver, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "cut", model)
    with pytest.raises(ResultsError, match="lacks part_5"):
        read(tmp_path / "cut")
    asked.clear()
    asked.append(7)
    made(tmp_path / "cut", model)
    assert asked[1:] == [5, 6, 7, 8, 9]
    np.testing.assert_array_equal(read(tmp_path / "cut").ways, read(whole).ways)


@pytest.mark.parametrize(("count", "seed"), [(15, 0), (10, 1)])
def test_layouts_of_another_kind_are_not_mixed_in(tmp_path, model, count, seed):
    made(tmp_path, model)
    with pytest.raises(ResultsError, match="holds other layouts"):
        made(tmp_path, model, count, seed)


def test_damage_is_noticed(tmp_path, model):
    made(tmp_path, model)
    part, card = tmp_path / "part_5.npz", tmp_path / CARD
    whole, text = part.read_bytes(), card.read_text()
    for damaged in (b"", whole[:-1], whole[:100] + b"x" + whole[101:]):
        part.write_bytes(damaged)
        with pytest.raises(ResultsError, match=r"part_5\.npz does not have the checksum"):
            read(tmp_path)
    part.unlink()
    with pytest.raises(ResultsError, match="cannot be read"):
        read(tmp_path)
    for damaged in ("", "{", text.replace("10", "11"), json.dumps({"format": "other"})):
        card.write_text(damaged)
        with pytest.raises(ResultsError, match="is damaged"):
            read(tmp_path)
    card.write_text(sealed({**unsealed(text), "format": "armctl-solved-layouts-2"}))
    for use in (read, lambda folder: made(folder, model)):
        with pytest.raises(ResultsError, match=r"format armctl-solved-layouts-2; armctl .* reads format armctl-s"):
            use(tmp_path)
    with pytest.raises(ResultsError, match="there are no layouts"):
        read(tmp_path / "nowhere")


@pytest.mark.parametrize("spoilt", [{"corners": np.array([1, 3])}, {"ways": np.full((4, 6), np.nan, np.float32)}])
def test_arrays_have_to_fit_together(spoilt):
    arrays = {
        "targets": np.zeros((2, 3), np.float32), "boxes": np.zeros((2, 11, 7), np.float32),
        "corners": np.array([2, 2]), "ways": np.zeros((4, 6), np.float32),
    }  # fmt: skip
    assert len(SolvedLayouts(**arrays)) == 2
    with pytest.raises(ConfigurationError):
        SolvedLayouts(**arrays | spoilt)
