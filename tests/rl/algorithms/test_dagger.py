import numpy as np
import pytest
import torch

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.rl.algorithms.dagger import MemorylessTeacher
from armctl.rl.algorithms.dagger import train as dagger
from armctl.rl.algorithms.distil import train as distil
from armctl.rl.run.training import Training
from armctl.training.learners import load_recipe
from tests.rl.small_trainings import asked, small


@pytest.mark.slow
def test_dagger_asks_the_teacher_where_the_pupil_gets_to(tmp_path, monkeypatch, unexported):
    from armctl.rl.data import demonstrations

    asked_in = []
    monkeypatch.setattr(
        demonstrations, "make_policy", lambda name, env, **_: asked_in.append(asked(env)) or asked_in[-1]
    )
    recipe = small(
        "reach_dagger",
        demonstrations=6,
        rounds=2,
        mixed_rounds=1,
        steps=20,
        teacher_memory=True,
        validation_episodes=2,
        evaluation_episodes=2,
    )
    dagger(recipe, out=tmp_path / "run", seed=0, progress=False)
    # the first round is the teacher's own, and short; in the second, a student of 10 gradient steps acts to the end
    assert 30 < len(asked_in[0].seen) < 60
    assert asked_in[0].resets == 6


def test_a_forgetful_teacher_begins_anew_in_each_state():
    env = make_worlds("armctl/ArmReach-v0", 2)
    observations, _ = env.reset(seed=0)
    teacher = asked(env)
    forgetful = MemorylessTeacher(teacher)
    first = forgetful.act(observations)
    far = env.reset(seed=7)[0]
    answers = forgetful.act(far)
    assert teacher.resets == 4
    assert not np.allclose(answers, first)
    teacher.reset(np.arange(2, dtype=np.int32))
    np.testing.assert_array_equal(teacher.act(far), answers)


@pytest.mark.slow
def test_dagger_goes_on_after_its_last_whole_round(tmp_path, monkeypatch, unexported):
    from armctl.rl.algorithms import dagger as module

    recipe = small(
        "reach_dagger",
        demonstrations=6,
        rounds=3,
        mixed_rounds=1,
        steps=30,
        validation_episodes=4,
        evaluation_episodes=4,
    )
    whole = dagger(recipe, out=tmp_path / "whole", seed=0, progress=False)
    evaluate_round, rounds = Training.evaluate, []

    def interrupted(self, actor, steps):
        rounds.append(steps)
        if len(rounds) == 2:
            raise KeyboardInterrupt
        evaluate_round(self, actor, steps)

    monkeypatch.setattr(Training, "evaluate", interrupted)
    with pytest.raises(KeyboardInterrupt):
        dagger(recipe, out=tmp_path / "cut", seed=0, progress=False)
    monkeypatch.setattr(Training, "evaluate", evaluate_round)
    assert module.RECORD in [file.name for file in (tmp_path / "cut").iterdir()]
    resumed = dagger(recipe, out=tmp_path / "cut", seed=0, resume=True, progress=False)
    assert resumed.training_steps == whole.training_steps == 30
    weights = [torch.load(tmp_path / run / "checkpoints" / "30.zip", weights_only=True) for run in ("whole", "cut")]
    for name, values in weights[0].items():
        torch.testing.assert_close(weights[1][name], values)


def test_rounds_need_episodes(tmp_path):
    with pytest.raises(ConfigurationError, match="5 rounds"):
        dagger(small("reach_dagger", demonstrations=4), out=tmp_path / "run", seed=0, progress=False)


@pytest.mark.slow
def test_a_privileged_teacher_has_a_pupil_who_sees_the_camera(tmp_path, unexported):
    recipe = small("reach_dagger", demonstrations=2, rounds=2, steps=4, validation_episodes=2, evaluation_episodes=2)
    recipe = recipe.changed(
        env="armctl/BridgeCross-v0",
        env_options={"resolution": (8, 6), "max_episode_steps": 8},
        teacher="bridge_ompl:prepared=false",
    )
    card = dagger(recipe, out=tmp_path / "run", seed=0, progress=False)
    assert card.observation_shape == {"image": [6, 8], "motion": [3]}
    assert card.teacher == "bridge_ompl:prepared=false"


@pytest.mark.slow
@pytest.mark.parametrize("teacher", ["reach_ik", "reach_mpc"])
@pytest.mark.parametrize(("train", "recipe"), [(dagger, "reach_dagger"), (distil, "distil")])
def test_a_teacher_that_takes_the_students_commands_for_its_own_is_refused(tmp_path, train, recipe, teacher):
    chosen = load_recipe(recipe, "armctl/ArmReach-v0").changed(teacher=teacher, shaping=None, options={"worlds": 2})
    with pytest.raises(ConfigurationError, match=f"{teacher}:prepared=false"):
        train(chosen, out=tmp_path / "run", seed=0, progress=False)
