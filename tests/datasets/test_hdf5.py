"""An HDF5 file is data from a stranger: it names no other file, and claims no more than it holds."""

import json
import os
import shutil
import sys
import types

import gymnasium
import h5py
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.datasets import hdf5
from armctl.datasets.demonstrations import Demonstration
from armctl.datasets.minari import read_demonstrations, write_dataset

ROWS, WIDTH = 5, 3
SEEN = gymnasium.spaces.Box(-np.inf, np.inf, (WIDTH,), np.float32)
TAKEN = gymnasium.spaces.Box(-1, 1, (2,), np.float32)
IMAGES = gymnasium.spaces.Dict(image=gymnasium.spaces.Box(0, 9, (4, 4), np.uint8), motion=SEEN)


def worlds(observations=SEEN):
    """What `read_demonstrations` asks of an environment."""
    task = types.SimpleNamespace(interface={"robot": "mine"})
    return types.SimpleNamespace(single_observation_space=observations, single_action_space=TAKEN, task=task)


def played(observations=SEEN):
    rng = np.random.default_rng(0)

    def some(space, count):
        return (rng.uniform(0, 9, (count, *space.shape))).astype(space.dtype)

    seen = (
        {name: some(space, ROWS) for name, space in observations.items()}
        if isinstance(observations, gymnasium.spaces.Dict)
        else some(observations, ROWS)
    )
    return Demonstration(seen, some(TAKEN, ROWS - 1), np.arange(ROWS - 1.0), True, True)


def metadata(observations=SEEN, count=2):
    from minari.serialization import serialize_space

    return {
        "total_episodes": count, "observation_space": serialize_space(observations),
        "action_space": serialize_space(TAKEN), "data_format": "hdf5",
    }  # fmt: skip


def without_checksums(data):
    about = json.loads((data / "metadata.json").read_text())
    del about["checksum"], about["sha256"]
    (data / "metadata.json").write_text(json.dumps(about))


@pytest.fixture
def data(tmp_path):
    """A dataset of somebody else: two episodes, no checksums."""
    write_dataset(tmp_path, [(played(), {"success": i == 1}) for i in range(2)], metadata())
    without_checksums(tmp_path / "data")
    secret = tmp_path / "secret.hdf5"
    with h5py.File(secret, "w") as file:
        file["values"] = np.full((ROWS, WIDTH), 7, np.float32)
    (tmp_path / "secret.bin").write_bytes(np.full((ROWS, WIDTH), 7, np.float32).tobytes())
    return tmp_path / "data"


def test_what_was_written_is_read(data):
    first, second = read_demonstrations(data, worlds())
    np.testing.assert_array_equal(first.observations, played().observations)
    np.testing.assert_array_equal(first.actions, played().actions)
    np.testing.assert_array_equal(first.rewards, played().rewards)
    assert (first.terminated, first.success, second.success) == (True, False, True)


def test_dicts_of_arrays_are_read(tmp_path):
    write_dataset(tmp_path, [(played(IMAGES), {})], metadata(IMAGES, 1))
    (read,) = read_demonstrations(tmp_path, worlds(IMAGES))
    for name, values in played(IMAGES).observations.items():
        np.testing.assert_array_equal(read.observations[name], values)
        assert read.observations[name].dtype == values.dtype


def external(group, secret):
    place = [(str(secret.with_suffix(".bin")), 0, h5py.h5f.UNLIMITED)]
    group.create_dataset("observations", (ROWS, WIDTH), np.float32, external=place)


def virtual(group, secret):
    layout = h5py.VirtualLayout((ROWS, WIDTH), np.float32)
    layout[:] = h5py.VirtualSource(str(secret), "values", (ROWS, WIDTH))
    group.create_virtual_dataset("observations", layout)


def virtual_of_itself(group, _):
    layout = h5py.VirtualLayout((ROWS, WIDTH), np.float32)
    layout[:] = h5py.VirtualSource(".", "/episode_1/observations", (ROWS, WIDTH))
    group.create_virtual_dataset("observations", layout)


def external_link(group, secret):
    group["observations"] = h5py.ExternalLink(str(secret), "/values")


def soft_link(group, _):
    group["observations"] = h5py.SoftLink("/episode_1/observations")


def soft_link_to_nothing(group, _):
    group["observations"] = h5py.SoftLink("/observations")


@pytest.mark.parametrize(
    "lead_out", [external, virtual, virtual_of_itself, external_link, soft_link, soft_link_to_nothing]
)
def test_values_elsewhere_are_not_read(data, lead_out):
    with h5py.File(data / hdf5.FILE, "a") as file:
        del file["episode_0/observations"]
        lead_out(file["episode_0"], data.parent / "secret.hdf5")
    with pytest.raises(ConfigurationError, match=r"observations of episode_0 (is a link|lies in another file)"):
        read_demonstrations(data, worlds())


def test_an_episode_elsewhere_is_not_read(data):
    shutil.copy(data / hdf5.FILE, data / "other.hdf5")
    with h5py.File(data / hdf5.FILE, "a") as file:
        del file["episode_0"]
        file["episode_0"] = h5py.ExternalLink("other.hdf5", "/episode_0")
    with pytest.raises(ConfigurationError, match="episode_0 is a link"):
        read_demonstrations(data, worlds())


def test_parts_of_observations_elsewhere_are_not_read(tmp_path):
    write_dataset(tmp_path, [(played(IMAGES), {})], metadata(IMAGES, 1))
    without_checksums(tmp_path / "data")
    with h5py.File(tmp_path / "data" / hdf5.FILE, "a") as file:
        file["elsewhere"] = file["episode_0/observations/image"]
        del file["episode_0/observations/image"]
        file["episode_0/observations/image"] = h5py.SoftLink("/elsewhere")
    with pytest.raises(ConfigurationError, match="image of episode_0 is a link"):
        read_demonstrations(tmp_path, worlds(IMAGES))


def replace(name, **arguments):
    def change(file):
        del file["episode_0"][name]
        file["episode_0"].create_dataset(name, **arguments)

    return change


WRONG = {
    "45 GB": (replace("actions", shape=(10**9, 2), dtype=np.float32, chunks=(1000, 2)), "claims 8,000,000,000 bytes"),
    "45 GB of observations": (replace("observations", shape=(10**9, WIDTH), dtype="f4", chunks=(9, 3)), "incomplete"),
    "10^18 rows": (replace("actions", shape=(10**18, 2), dtype=np.float64, chunks=(1000, 2)), "claims 16,0.* bytes"),
    "no values": (replace("observations", shape=(ROWS, WIDTH), dtype=np.float32, chunks=True), "claims 60 bytes"),
    "compressed": (replace("observations", data=np.zeros((ROWS, WIDTH), "f4"), compression=9), "compressed"),
    "complex": (replace("observations", data=np.zeros((ROWS, WIDTH), complex)), "values of type complex128"),
    "1e300": (replace("observations", data=np.full((ROWS, WIDTH), 1e300)), "not finite, or beyond 1e.12"),
    "1e30 as a reward": (replace("rewards", data=np.full(ROWS - 1, 1e30)), "rewards .* not finite, or beyond"),
    "not a number": (replace("observations", data=np.full((ROWS, WIDTH), np.nan)), "not finite"),
    "infinite": (replace("actions", data=np.full((ROWS - 1, 2), np.inf)), "not finite"),
    "reward that is no number": (replace("rewards", data=np.full(ROWS - 1, np.nan)), "rewards .* not finite"),
    "text": (replace("observations", data=np.full((ROWS, WIDTH), b"text")), r"values of type \|S4"),
    "objects": (replace("actions", data=["a"] * (ROWS - 1), dtype=h5py.string_dtype()), "values of type object"),
    "ragged": (replace("actions", shape=(ROWS - 1, 2), dtype=h5py.vlen_dtype(np.uint8)), "values of type object"),
    "records": (replace("rewards", shape=(ROWS - 1,), dtype=[("a", "f4"), ("b", "f4")]), "values of type"),
    "references": (replace("rewards", shape=(ROWS - 1,), dtype=h5py.ref_dtype), "values of type object"),
    "a scalar": (replace("actions", data=np.float32(1)), "incomplete"),
    "nothing": (replace("actions", dtype="f4", data=h5py.Empty("f4")), "incomplete"),
    "no rows": (replace("actions", data=np.zeros((0, 2), np.float32)), "incomplete"),
    "too many rewards": (replace("rewards", data=np.zeros(ROWS)), "rewards of episode_0 is incomplete"),
    "of other width": (replace("actions", data=np.zeros((ROWS - 1, 3))), "actions of episode_0 is incomplete"),
    "a group": (lambda file: (file["episode_0"].pop("rewards"), file["episode_0"].create_group("rewards")), "not a da"),
    "no episode": (lambda file: file.pop("episode_1"), "has no episode_1"),
    "an episode that is an array": (lambda file: (file.pop("episode_1"), file.update(episode_1=1)), "not a group"),
    "success in words": (lambda file: file["episode_0"].attrs.update(success="yes"), "neither true nor false"),
    "successes": (lambda file: file["episode_0"].attrs.update(success=[1, 2]), "neither true nor false"),
}


@pytest.mark.parametrize(("change", "says"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_with_values_is_said(data, change, says):
    with h5py.File(data / hdf5.FILE, "a") as file:
        change(file)
    with pytest.raises(ConfigurationError, match=f"the dataset .* cannot be used: .*{says}"):
        read_demonstrations(data, worlds())


@pytest.mark.slow
def test_one_array_under_many_names_is_not_read_many_times(data):
    """Hard links would make a small file fill the memory."""
    with h5py.File(data / hdf5.FILE, "a") as file:
        for i in range(2, 1_000):
            file[f"episode_{i}"] = file["episode_0"]
    (data / "metadata.json").write_text(json.dumps(metadata(count=1_000)))
    with pytest.raises(ConfigurationError, match=r"claims .* bytes"):
        read_demonstrations(data, worlds())


def test_a_file_of_45_gigabytes_that_holds_nothing_is_not_read(data):
    with h5py.File(data / hdf5.FILE, "a") as file:
        del file["episode_0/actions"]
        file["episode_0"].create_dataset("actions", shape=(5 * 10**10, 2), dtype=np.float32)
        file["episode_0/actions"][-1] = 1  # a hole in the file, which takes no space
    assert (data / hdf5.FILE).stat().st_size > 4e11
    with pytest.raises(ConfigurationError, match=r"claims 400,000,000,000 bytes"):
        read_demonstrations(data, worlds())


def test_extra_parts_are_not_read(data):
    with h5py.File(data / hdf5.FILE, "a") as file:
        file["episode_0/infos/secret"] = h5py.ExternalLink("/dev/zero", "/")
        file["episode_2"] = h5py.SoftLink("/nowhere")
    assert len(read_demonstrations(data, worlds())) == 2


METADATA = {
    "episodes in words": ({"total_episodes": "two"}, "not a readable Minari dataset"),
    "a million episodes": ({"total_episodes": 10**18}, "has no episode_2"),
    "no episodes": ({"total_episodes": 0}, "has no episodes"),
    "another format": ({"data_format": "arrow"}, "its format is 'arrow', and armctl reads hdf5 only"),
    "a space of 45 GB": (
        {"observation_space": '{"type": "Box", "dtype": "float32", "shape": [11000000000], "low": 0, "high": 1}'},
        r"observations \[11000000000\]",
    ),
    "a space of no kind": ({"observation_space": '{"type": "os.system"}'}, "not a readable Minari dataset"),
    "a deep space": ({"action_space": "[" * 100_000}, "not a readable Minari dataset"),
    "spaces in spaces": (
        {"action_space": '{"type": "Dict", "subspaces": {"a": ' * 500 + "{}" + "}}" * 500},
        "not a readable Minari dataset",
    ),
    "an interface in words": ({"interface": "mine"}, "not a readable Minari dataset"),
    "another interface": ({"interface": {"robot": "\x1b[31m" + "x" * 9_999}}, r"robot '\\x1b\[31mx.{,60}, but here"),
}


@pytest.mark.parametrize(("change", "says"), METADATA.values(), ids=METADATA)
def test_what_is_wrong_with_metadata_is_said(data, change, says):
    (data / "metadata.json").write_text(json.dumps(metadata() | change))
    with pytest.raises(ConfigurationError, match=says):
        read_demonstrations(data, worlds())


def test_large_metadata_is_refused(data):
    with (data / "metadata.json").open("r+b") as file:
        file.truncate(10**11)
    with pytest.raises(ConfigurationError, match="not a readable"):
        read_demonstrations(data, worlds())


def test_metadata_runs_no_code(data, monkeypatch):
    """Neither an environment's specification nor anything else in it names code that is imported."""
    (data / "evil.py").write_text("import pathlib; pathlib.Path('ran').touch()")
    monkeypatch.chdir(data)
    monkeypatch.syspath_prepend(str(data))
    spec = json.dumps({"id": "evil:Evil-v0", "entry_point": "evil:Evil", "kwargs": {}, "additional_wrappers": []})
    about = metadata() | {"env_spec": spec, "eval_env_spec": spec, "env": "evil:Evil-v0"}
    (data / "metadata.json").write_text(json.dumps(about))
    assert len(read_demonstrations(data, worlds())) == 2
    del about["observation_space"]  # Minari would make the environment to know its spaces
    (data / "metadata.json").write_text(json.dumps(about))
    with pytest.raises(ConfigurationError, match="does not declare"):
        read_demonstrations(data, worlds())
    assert "evil" not in sys.modules
    assert not (data / "ran").exists()


@pytest.mark.parametrize("name", [hdf5.FILE, "metadata.json"])
def test_a_pipe_in_a_files_place_is_not_waited_for(data, name):
    (data / name).unlink()
    os.mkfifo(data / name)
    with pytest.raises(ConfigurationError, match="there is no"):
        read_demonstrations(data, worlds())


@pytest.mark.parametrize("name", ["\0", "a" * 300, "nowhere"])
def test_a_name_that_is_no_folder_is_refused(name, monkeypatch, tmp_path):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    with pytest.raises(ConfigurationError, match="there is no Minari dataset"):
        read_demonstrations(name, worlds())
    assert not (tmp_path / "datasets").exists()


# What armctl writes


@pytest.fixture
def own(tmp_path):
    write_dataset(tmp_path / "own", [(played(), {})] * 2, metadata())
    return tmp_path / "own" / "data"


def test_a_changed_value_is_noticed(own):
    with h5py.File(own / hdf5.FILE, "a") as file:
        file["episode_1/actions"][0, 0] = 0.5
    with pytest.raises(
        ConfigurationError, match=r"main_data.hdf5 is damaged, or was changed.*delete the entries sha256"
    ):
        read_demonstrations(own, worlds())
    without_checksums(own)
    assert read_demonstrations(own, worlds())[1].actions[0, 0] == 0.5


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")])
def test_the_checksum_of_a_pipe_or_of_an_endless_file_is_not_waited_for(own, make):
    (own / hdf5.FILE).unlink()
    make(own / hdf5.FILE)
    with pytest.raises(ConfigurationError, match="not a regular file"):
        read_demonstrations(own, worlds())


def test_the_checksum_of_a_file_without_end_is_not_computed(own):
    os.truncate(own / hdf5.FILE, 10**13)
    with pytest.raises(ConfigurationError, match="10,000,000,000,000 bytes, more than"):
        read_demonstrations(own, worlds())


def test_changed_metadata_is_noticed(own):
    text = (own / "metadata.json").read_text()
    (own / "metadata.json").write_text(text.replace('"total_episodes": 2', '"total_episodes": 1'))
    with pytest.raises(
        ConfigurationError, match=r"metadata.json is damaged, or was changed.*delete the entry checksum"
    ):
        read_demonstrations(own, worlds())
