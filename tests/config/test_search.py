"""Tree searches in configuration files."""

from __future__ import annotations

import shutil

import pytest
from places import EXAMPLES

import mdm
from mdm.testing import capture_decisions, run_virtual


def load(folder, search, policy='"tiger.vf"', model='model = "tiger.pomdp"'):
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copy(EXAMPLES / name, folder / name)
    text = f"""
        [ensembles.tiger]
        {model}
        policy = {policy}
        seed = 4
        search = {search}
        [ensembles.tiger.actions]
        listen = "gc:collect"
        open-left = "gc:collect"
        open-right = "gc:collect"
    """
    (folder / "system.toml").write_text(text)
    return mdm.load_system(folder / "system.toml")


def test_a_search_with_its_fallback(tmp_path):
    system = load(tmp_path, "{ expansions = 200, seconds = 0.5, plans = true, particles = 50 }")
    policy = system.ensembles["tiger"].controller.policy
    assert isinstance(policy, mdm.solvers.TreeSearch)
    assert isinstance(policy.fallback, mdm.policies.AlphaVectors)
    assert (policy.expansions, policy.seconds) == (200, 0.5)
    assert policy.parts()[1]["seed"] == 4
    assert policy.parts()[1]["particles"] == 50
    assert policy.value([0.5, 0.5]) > 19

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            for _ in range(2):
                system.ensembles["tiger"].publish_observation(0)
        return [decision.action_name for decision in decisions]

    assert run_virtual(main) == ["listen", "listen", "open-right"]


@pytest.mark.parametrize(
    ("search", "options", "text"),
    [
        ("{ second = 1.0 }", {}, "second"),
        ("{ seconds = 0.0 }", {}, "seconds"),
        ("{ }", {}, "a tree search needs an end: give it seconds, or a number of expansions"),
        ("{ expansions = 5 }", {"model": "", "policy": "[0, 1]"}, "a search needs a model to look ahead in"),
        (
            "{ expansions = 5, plans = true }",
            {"policy": "[0, 1]"},
            "plans are alpha vectors, but the policy is of another",
        ),
        ("{ expansions = 5 }", {"policy": "[0, 1]"}, "the fallback chooses by state, but the search by belief"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(tmp_path, search, options, text):
    with pytest.raises(mdm.ConfigError, match=text) as raised:
        load(tmp_path, search, **options)
    assert "ensembles.tiger.search" in str(raised.value)
