"""Each module has its tests in files of the same place and name; what has none, or is none's, says why.

A file is named `test_NAME.py`, or `test_NAME_SUBJECT.py` where a module has several.
"""

from __future__ import annotations

from pathlib import Path

from places import ROOT

import mdm

PACKAGE, TESTS = Path(mdm.__file__).parent, ROOT / "tests"  # the package may be an installed one

UNTESTED_ALONE = {
    "messages.py": "declares types alone",
    "faults.py": "declares kinds alone, which test_reference compares with the code",
    "version.py": "a line: test_public",
    "stimuli.py": "declares messages: test_schemas",
    "team/layer.py": "a base: the layers of each mode are tested",
    "policies/supported.py": "what verification/supports.py makes, tested there",
    "actors/layer.py": "a base: its layers are tested",
    "latency/probe.py": "with all that it stamps: test_measure",
    "latency/others.py": "programs of other processes: test_measure",
    "team/centralised/messages.py": "declares messages: the leader and its followers are tested",
    "snapshots/frame.py": "declares types alone",
    "ros2/wire.py": "declares types alone",
    "cli/map/floor.py": "with the verbs that load a floor, and draw it: test_check, test_show",
    "beliefs/dense.py": "with every other filter, against one computation: test_filter",
    "beliefs/compressed.py": "with every other filter, against one computation: test_filter",
    "beliefs/kernels.py": "the loops of filters, which test_filter compares compiled and not",
    "policies/alpha_kernels.py": "the loops of AlphaVectors, compared compiled and not by its tests",
    "verification/kernels.py": "the loops of choices and sweeps, compared compiled and not by test_optimum",
    "solvers/mdp/sweeps.py": "the loops of backups and of InformedBound, which tests of these compare compiled and not",
}
"""Modules that have no tests of their own, and where they are tested."""

ACROSS = {
    "chaos/test_chaos.py": "random systems under random faults",
    "chaos/test_processes.py": "robots as real processes that get signals",
    "chaos/test_planted.py": "that the scenarios find faults that are planted",
    "views/web/test_browser.py": "the page in a browser",
    "views/web/test_connection.py": "the page in a browser, where what it shows breaks, ends and begins anew",
    "views/web/test_keys.py": "the keys of the page in a browser",
    "verification/test_storm.py": "all numbers, against those of another program",
    "cli/test_commands.py": "what all verbs have in common",
    "cli/records/test_bad_records.py": "what all verbs of records have in common",
    "cli/test_loading.py": "which modules the verbs load",
    "cli/test_wrong_input.py": "wrong input, for all verbs",
    "config/test_amounts.py": "what follows from the numbers of all tables",
    "config/test_mutations.py": "mutated files, all of them",
    "actors/control/test_controller_run.py": "control layers that run the nodes of a plan",
    "actors/actions/test_failed_actions.py": "the action layer: actions that fail, or do not end",
    "actors/actions/test_groups.py": "safety: actions of a group",
    "actors/safety/test_safe_starts.py": "safety: ends and failures in the middle of a start",
    "actors/test_ladder.py": "all that may happen to three ensembles above each other",
    "actors/test_many.py": "many ensembles in one runtime",
    "actors/test_hierarchy.py": "ensembles above and below each other",
    "actors/safety/test_after_failures.py": "safety: what follows a failure",
    "actors/safety/test_lost_input.py": "safety: input that is lost",
    "actors/safety/test_last_word.py": "safety: the order of safe actions at an end",
    "actors/safety/test_safe_end.py": "safety: the end of ensembles",
    "actors/safety/test_safe_order.py": "safety: ensembles above and below each other",
    "actors/safety/test_starved.py": "safety: input that a turn without end keeps waiting",
    "actors/safety/test_way_back.py": "safety: what follows a safe mode",
    "formats/test_strict.py": "what is written, read by readers as strict as the original tools",
    "formats/test_policy_corpus.py": "the policies of other programs, in every format",
    "formats/test_policy_fuzz.py": "damaged policies, in every format",
    "replay/test_brought_back.py": "robots of a team that were brought back stopped",
    "replay/test_end.py": "how runs and replays of them end",
    "replay/test_processes.py": "runs of real processes that signals end",
    "replay/test_random_systems.py": "random systems, recorded in wall time",
    "replay/test_rules.py": "that a replay needs each of the rules of time",
    "problems/test_problems.py": "what all problems have in common",
    "problems/test_files.py": "the problems against the files of others",
    "problems/test_figures.py": "the problems against what others computed",
    "simulation/building/test_closed_loop.py": "robots that patrol a building for an hour",
    "simulation/test_maiss.py": "a hierarchy of robots, from a file to its decisions",
    "cli/team/test_fresh.py": "the options of several verbs: what becomes of a stop",
    "team/test_never_met.py": "teams of which nobody has met the others",
    "team/test_returns.py": "teams that are stopped, killed and brought back, in virtual time",
    "team/test_brought_back.py": "the same with real processes",
    "team/test_bad_input.py": "running teams over real sessions, and what must not harm them",
    "team/test_membership.py": "members of replicated teams that come and go",
    "team/test_leftovers.py": "members that come and go, over real sessions",
    "team/test_processes.py": "members in processes of their own, over real sessions",
    "team/test_forgery.py": "teams that are sent forged messages",
    "team/test_commanded.py": "teams of real processes that are cut off, commanded and healed",
    "team/test_planted.py": "that random schedules find faults that are planted in the agreement",
    "team/test_schedules.py": "the agreement under random faults",
    "team/test_search.py": "the agreement in all that can happen to a few agents",
    "team/test_sweep.py": "that larger searches find what small ones do",
    "team/transport/test_renewed.py": "certificates that are made anew while sessions hold them",
    "cli/team/test_wrong_addresses.py": "teams whose files name addresses that are wrong",
    "cli/team/test_mapped_ports.py": "teams in networks of their own, behind mapped ports and routers",
    "ros2/test_environment.py": "the peers of the tests against the real ROS 2",
    "ros2/test_flood.py": "whole systems beside real nodes: floods and large messages",
    "ros2/test_patrol.py": "the demo's robot behind NavigateToPose",
    "ros2/test_pursuits.py": "random goals and pre-emptions against a real server",
    "ros2/test_schedules.py": "random schedules of what may happen to a robot of ROS",
    "ros2/test_whole.py": "whole systems beside real nodes",
    "ros2/test_page.py": "a program of the pages, beside a robot of ROS",
    "test_solved.py": "the policies that tests start from",
    "test_benchmarks.py": "programs beside the package",
    "test_examples.py": "programs beside the package",
    "test_foxglove.py": "an example beside the package, against types that others have published",
    "test_errands.py": "programs beside the package: trees and state machines as actions",
    "test_patrol_view.py": "what the demo draws",
    "test_trees_and_machines.py": "programs beside the package: what is each library's own",
    "test_ensembles_within.py": "programs beside the package: ensembles within trees and state machines",
    "test_design.py": "the drawing of the house, and a value's way through it",
    "test_documentation.py": "pages",
    "test_docstrings.py": "docstrings",
    "test_public.py": "the public names",
    "test_reference.py": "the pages of the reference",
    "test_blocks.py": "the blocks of code on the pages",
    "test_house.py": "the pages for contributors",
    "test_sentences.py": "the golden files of sentences",
    "test_words.py": "the words of pages and sentences",
    "test_values.py": "which values options are given in a complete run",
    "same/test_same.py": "programs beside the package: what two commits do",
    "test_mirror.py": "this",
    "test_wheel.py": "how wheels are built",
}
"""Tests of no single module."""


def test_each_module_has_its_tests():
    modules = {path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.py") if not path.name.startswith("__")}
    untested = {path.as_posix() for path in modules if not _tests_of(path)}
    assert untested == set(UNTESTED_ALONE)


def test_each_file_of_tests_has_its_module():
    files = {path.relative_to(TESTS) for path in TESTS.rglob("test_*.py")}
    without = {path.as_posix() for path in files if not _has_module(path)}
    assert without == set(ACROSS)


def _tests_of(module: Path) -> list[Path]:
    folder = TESTS / module.parent
    return [*folder.glob(f"test_{module.stem}.py"), *folder.glob(f"test_{module.stem}_*.py")]


def _has_module(test: Path) -> bool:
    words = test.stem.split("_")[1:]
    names = ["_".join(words[:length]) for length in range(1, len(words) + 1)]
    return any((PACKAGE / test.parent / f"{name}.py").is_file() for name in names)
