"""Searches on a controller that is known; one that was killed goes on."""

import pytest

from diagrams.episodes.store import RowStore
from diagrams.hybrid import search
from diagrams.hybrid.perturbations import Perturbation
from diagrams.hybrid.search import SAMPLERS, Trial, make_sampler
from diagrams.world.disturbance import DisturbanceSpec
from models.errors import InputError


def propose(suggest):
    """Deflections, but for a tenth of the proposals."""
    size, hold = suggest("size_deg", 0.0, 60.0), round(suggest("hold_ticks", 0.0, 25.0))
    scene, moment = int(2 * suggest("scene", 0.0, 0.9999)), suggest("moment", 0.0, 1.0)
    return None if moment > 0.9 else Perturbation(scene, DisturbanceSpec("A", 0.1 + moment, [0.0] * 7, hold), size)


def run(perturbation):
    """The controller is defeated from 20 deg and 10 ticks on."""
    size = perturbation.size_deg
    fails = size > 20.0 and perturbation.disturbance.hold_ticks > 10
    objective = perturbation.magnitude if fails else 1.0 + (20.0 - min(size, 20.0)) / 20.0
    failure = "not returned" if fails else None
    return Trial(perturbation, failure, failure, not fails, objective, size, "hash")


def search_all(folder, trials=25, run=run, samplers=SAMPLERS, seed=3, **more):
    with RowStore(folder / "trials.jsonl", {"seed": seed}) as store:
        return search.search_all(propose, run, trials, seed, store, samplers, **more)


def test_searches_have_the_same_budget_and_their_seed(tmp_path):
    found = search_all(tmp_path)
    assert {name: len(trials) for name, trials in found.items()} == dict.fromkeys(SAMPLERS, 25)
    everything = [trial.perturbation for trials in found.values() for trial in trials]
    assert all(p.disturbance.level <= 1.0 for p in everything)
    assert {p.scene for p in everything} == {0, 1}
    assert found["tpe"][0] != found["random"][0]  # TPE begins as random search does, with a seed of its own
    seen = {"random": [], "tpe": []}
    again = search_all(
        tmp_path / "again", samplers=("random", "tpe"), on_trial=lambda name, number, trial: seen[name].append(trial)
    )
    assert seen == again == {name: found[name] for name in ("random", "tpe")}


def test_a_search_that_was_killed_goes_on(tmp_path):
    whole = search_all(tmp_path)
    path = tmp_path / "trials.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:41]) + lines[41][:50])  # the kill came in the middle of a line
    ran = []

    def counted(perturbation):
        ran.append(perturbation)
        return run(perturbation)

    assert search_all(tmp_path, run=counted) == whole
    assert len(ran) == 3 * 25 - 40
    ran.clear()
    longer = search_all(tmp_path, trials=30, run=counted)
    assert len(ran) == 3 * 5
    assert {name: trials[:25] for name, trials in longer.items()} == whole


def test_the_trials_of_another_search_are_refused(tmp_path):
    search_all(tmp_path, trials=1)
    with pytest.raises(
        InputError, match=r"trials\.jsonl was made with another seed \(3, now 4\): choose another --out"
    ):
        search_all(tmp_path, seed=4)


def test_a_search_without_any_perturbation_ends():
    assert search.search(make_sampler("random", 0), lambda suggest: None, lambda *_: None, 2) == []


def test_an_error_in_a_search_is_not_lost(tmp_path):
    def broken(perturbation):
        raise RuntimeError("the plant broke")

    with pytest.raises(RuntimeError, match="the plant broke"):
        search_all(tmp_path, trials=1, run=broken, samplers=("random",))
