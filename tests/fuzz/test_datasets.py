"""Mutated datasets: each is read, and its episodes are whole, or it is refused in words."""

import copy
import itertools
import json
from pathlib import Path

import pytest

from armctl.datasets.collect import collect

from .child import Child
from .mutation import mutated_bytes, outcomes_of

pytest.importorskip("minari")

HDF5, METADATA = "main_data.hdf5", "metadata.json"
HOSTILE = [
    None, True, -1, 0, 10**18, 10**400, 1e300, float("nan"), "", "x" * 10_000, [], {}, [[]], {"type": "Box"}, "[]",
    '{"type": "Dict"}', '{"type": "Box", "shape": [10000000000], "dtype": "O", "low": 0, "high": 1}',
    '{"type": "MultiBinary", "n": "x"}', '{"type": "Discrete", "n": 0, "start": "x"}', "import os", "../../x",
]  # fmt: skip
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """The files of a dataset of 6 episodes."""
    out = tmp_path_factory.mktemp("collected")
    collect("random", episodes=6, out=out, env_options={"max_episode_steps": 12})
    return {name: (out / "data" / name).read_bytes() for name in (HDF5, METADATA)}


@pytest.fixture(scope="module")
def load(tmp_path_factory, content):
    folder, child, numbers = tmp_path_factory.mktemp("datasets"), Child(HERE / "load_dataset.py"), itertools.count()

    def write_and_load(**changed):
        data = folder / str(next(numbers))
        data.mkdir()
        for name, original in content.items():
            (data / name).write_bytes(changed.get(Path(name).suffix[1:], original))
        return child(data)

    yield write_and_load
    child.close()


def mutations(content):
    metadata = json.loads(content[METADATA])
    bare = {name: value for name, value in metadata.items() if name != "checksum"}

    def mutate_hdf5(load, rng):
        return load(hdf5=mutated_bytes(rng, content[HDF5]))

    def mutate_metadata(load, rng):
        return load(json=mutated_bytes(rng, content[METADATA]))

    def mutate_values(load, rng):
        """As somebody would who leaves the checksum of all away."""
        changed = copy.deepcopy(bare)
        for _ in range(rng.randint(1, 3)):
            name = rng.choice(sorted(changed))
            if rng.random() < 0.3:
                del changed[name]
            elif isinstance(changed[name], dict) and changed[name] and rng.random() < 0.7:
                changed[name][rng.choice(sorted(changed[name]))] = rng.choice(HOSTILE)
            else:
                changed[name] = rng.choice(HOSTILE)
        return load(json=json.dumps(changed).encode())

    return {"hdf5": mutate_hdf5, "metadata": mutate_metadata, "values": mutate_values}


@pytest.mark.slow
def test_the_dataset_is_fine_as_it_is(load):
    assert load() == ("fine", "6 episodes")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hdf5", "metadata", "values"])
def test_a_mutated_dataset_is_read_or_refused(load, content, kind):
    assert "refused" in outcomes_of(load, mutations(content)[kind], 25)


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "count"), [("hdf5", 500), ("metadata", 250), ("values", 250)])
def test_a_thousand_mutated_datasets_are_read_or_refused(load, content, kind, count):
    outcomes = outcomes_of(load, mutations(content)[kind], count)
    assert "refused" in outcomes
    assert ("fine" in outcomes) <= (kind != "hdf5")  # no changed byte of the values goes unnoticed
