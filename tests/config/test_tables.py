"""Every mistake in a file is told with its key."""

from __future__ import annotations

import inspect

import msgspec
import pytest
from loading import written
from robot_file import GOOD

from mdm import Binding, ConfigError, Ensemble, Restart, Team, load_system, shield
from mdm.actors.options import BindingSettings, SafetySettings
from mdm.config import tables
from mdm.config.places import PlacesTable
from mdm.config.team_file import AllowanceTable, TeamTable
from mdm.maps import Places, load_map
from mdm.maps.places import PlacesSettings
from mdm.solvers import TreeSearch
from mdm.team.team import TeamSettings
from mdm.team.transport.allowance import Allowance

WRONG = [
    ("[predicates]", "[predicats]", "predicats", "there is no key 'predicats'"),
    ('B = "not A"', 'B = "not AA"', "predicates", "'B' uses 'AA', which is not declared; did you mean 'A'"),
    ('B = "not A"', 'B = "not"', "predicates.B", "(column 4)"),
    ('B = "not A"', 'B = "C"\nC = "B"', "predicates", "cycle"),
    ("max_age = 60.0", "max_age = -1.0", "predicates.A", "max_age"),
    ("max_age = 60.0", "max_age = inf", "predicates.A.max_age", "at most 1,000,000,000 was expected, not inf"),
    (
        "max_age = 60.0",
        "max_age = nan",
        "predicates.A.max_age",
        "above 0 and at most 1,000,000,000 was expected, not nan",
    ),
    ("initial = false", "sensor = false", "predicates.A", "needs a 'formula'"),
    ('formula = "A", ', 'formula = "A", initial = true, ', "predicates.Long", "a formula has no key 'initial'"),
    ("held_for = 2.0", "held_for = inf", "predicates.Long.held_for", "at most 1,000,000,000"),
    ('Up = "A"', 'Up = "A or"', "events.Up", "(column 5)"),
    ('Up = "A"', 'Up = "Aa"', "events.Up", "'Up' uses 'Aa', which is not declared; did you mean 'A'"),
    ("max_age = 60.0", "maxage = 60.0", "predicates.A.maxage", "did you mean 'max_age'"),
    (
        "max_age = 60.0",
        'max_age = "x"',
        "predicates.A.max_age",
        "a number of seconds above 0 and at most 1,000,000,000 was expected, not 'x'",
    ),
    ('formula = "A", ', "", "predicates.Long", "needs a formula"),
    (', reset = "Ping"', "", "predicates.Seen", "both 'set' and 'reset'"),
    ('"Work.succeeded"', '"Wrok.succeeded"', "predicates", "unknown action; did you mean 'Work'"),
    ('set = "Work', 'formula = "A", set = "Work', "predicates.Seen", "not both"),
    ("policy = [0, 1]", "policy = [0, 2]", "ensembles.top.policy", "is 2"),
    ("policy = [0, 1]", "policy = [0, 1, 1]", "ensembles.top.states", "make 2 states, but the policy is for 3"),
    ("policy = [0, 1]\n", "", "ensembles.top", "required key 'policy' is missing"),
    ('policy = "below.policy"', 'policy = "belw.policy"', "ensembles.below.policy", "no such file"),
    ('policy = "below.policy"', 'policy = "cut.policy"', "ensembles.below.policy", "before the brackets"),
    ('policy = "below.policy"', 'policy = "three.policy"', "ensembles.below.states", "the policy is for 3"),
    ('policy = "below.policy"', 'model = "no.mdp"\npolicy = "below.policy"', "ensembles.below.model", "no such file"),
    ("drive = 2.0", "drive = -2.0", "ensembles.below.drive", "rate"),
    ("drive = 2.0", "drive = 1e-9", "ensembles.below.drive", "a rate is at least 0.000001"),
    ("drive = 2.0", "drive = nan", "ensembles.below.drive", "a rate is at least 0.000001"),
    ("drive = 2.0", "drive = inf", "ensembles.below.drive", "rate"),
    (
        "drive = 2.0",
        "deadline = 0.0",
        "ensembles.below.deadline",
        "seconds above 0 and at most 1,000,000,000 was expected, not 0.0",
    ),
    ("drive = 2.0", "deadline = inf", "ensembles.below.deadline", "at most 1,000,000,000"),
    ("drive = 2.0", "seed = -1", "ensembles.below.seed", "of at least 0 was expected, not -1"),
    ("drive = 2.0", 'rewards = "no.rewards"', "ensembles.below.rewards", "no such file"),
    ("drive = 2.0", 'rewards = ""', "ensembles.below.rewards", "path of a file"),
    ('"below.policy"', '"below\\u0000.policy"', "ensembles.below.policy", "path of a file"),
    ("{ restart = 2 }", "{ restart = -2 }", "ensembles.below.supervision.restart", "of at least 0"),
    ("{ restart = 2 }", "{ restrt = 2 }", "ensembles.below.supervision.restrt", "did you mean 'restart'"),
    ("{ restart = 2 }", '"pray"', "ensembles.below.supervision", "'pray' is not one of 'stop', 'escalate'"),
    ("[ensembles.below]", "[ensembles.predicates]", "ensembles.predicates", "give it another name"),
    ("[ensembles.below]", '[ensembles.""]', "ensembles.", "give it another name"),
    ("drive = 2.0", 'drive = "often"', "ensembles.below.drive", "often"),
    ("horizon = 5", "horizn = 5", "ensembles.below.horizn", "did you mean 'horizon'"),
    ("horizon = 5", "horizon = 0", "ensembles.below.horizon", "at least 1"),
    ('"hold"', '"keep"', "ensembles.below.states.a.on_violation", "'keep' is not one of 'first', 'hold', 'error'"),
    ('predicates = ["A"]', 'predicates = ["Aa"]', "ensembles.below.states.a", "'Aa'"),
    ('b = ["B"]', 'b = ["Ping"]', "ensembles.top.states.b", "no declared predicate"),
    (
        'safe_action = "Rest"',
        'safe_action = "Reset"',
        "ensembles.top.safe_action",
        "no action 'Reset' for safe_action; ",
    ),
    ('Rest = "robot_code:rest"\n[ensembles.below]', "[ensembles.below]", "ensembles.top", "0 to 0"),
    ("robot_code:work", "robot_code:wrk", "ensembles.below.actions.Work", "no 'wrk'; did you mean 'work'"),
    ("robot_code:work", "robot_cod:work", "ensembles.below.actions.Work", "no module 'robot_cod'"),
    ("robot_code:work", "broken_code:work", "ensembles.below.actions.Work", "ZeroDivisionError"),
    ("robot_code:work", "leaving_code:work", "ensembles.below.actions.Work", "SystemExit"),
    ("robot_code:work", "robot_code:number", "ensembles.below.actions.Work", "is a int, not a function"),
    ("robot_code:work", "work", "ensembles.below.actions.Work", "'module:name'"),
    (
        "timeout = 3.0",
        "timeout = -3.0",
        "ensembles.below.actions.Work.timeout",
        "above 0 and at most 1,000,000,000 was expected, not -3.0",
    ),
    ("timeout = 3.0", "timeut = 3.0", "ensembles.below.actions.Work.timeut", "did you mean 'timeout'"),
    ('ensemble = "below"', 'ensemble = "bellow"', "ensembles.top.actions.Below", "did you mean 'below'"),
    ('ensemble = "below"', 'ensemble = "top"', "ensembles.top.actions.Below", "cycle: top -> top"),
    (
        'ensemble = "below"',
        'call = "robot_code:rest", ensemble = "below"',
        "ensembles.top.actions.Below",
        "either a function",
    ),
    (
        'Rest = "robot_code:rest"\n[ensembles.below]',
        'Rest = { ensemble = "below" }\n[ensembles.below]',
        "ensembles.top.safe_action",
        "the safe action has to be a function",
    ),
    ('tasks = ["robot_code:sense"]', 'tasks = ["robot_code:not_async"]', "tasks", "not an async function"),
    ('tasks = ["robot_code:sense"]', 'tasks = ["robot_code:no_argument"]', "tasks", "one argument, the System"),
    ('tasks = ["robot_code:sense"]', 'tasks = "robot_code:sense"', "tasks", "a list of functions"),
    ("[predicates]", "starved_after = 0\n[predicates]", "starved_after", "a number of seconds above 0"),
    ("[predicates]", "starved_after = 'soon'\n[predicates]", "starved_after", "a number of seconds above 0"),
    ("[predicates]", "emergency = 7\n[predicates]", "emergency", "must be a function, such as 'robot:cut_motors'"),
    ("[predicates]", 'emergency = "robot_code:brake"\n[predicates]', "emergency", "has no 'brake'"),
    ("[predicates]", 'emergency = "robot_code:work"\n[predicates]', "emergency", "must be a plain function"),
    ("[predicates]", 'emergency = "robot_code:not_async"\n[predicates]', "emergency", "called without arguments"),
]


@pytest.mark.parametrize(("old", "new", "key", "words"), WRONG)
def test_every_mistake_is_told_with_its_key(folder, old, new, key, words):
    assert GOOD.count(old) >= 1
    text = GOOD.replace(old, new, 1)
    if not words:
        assert load_system(
            written(folder, text, "robot.toml")
        ).top  # two actions of one parent may start the same ensemble
        return
    with pytest.raises(ConfigError) as caught:
        load_system(written(folder, text, "robot.toml"))
    assert any(str(problem).startswith(f"{folder / 'robot.toml'}: {key}") for problem in caught.value.problems)
    assert words in str(caught.value)


TAKEN_BY = [
    (tables.EnsembleTable, (Ensemble, SafetySettings)),
    (tables.ActionTable, (Binding, BindingSettings)),
    (tables.RestartTable, (Restart,)),
    (tables.SearchTable, (TreeSearch,)),
    (tables.ShieldTable, (shield,)),
    (PlacesTable, (Places, PlacesSettings, load_map)),
    (TeamTable, (Team, TeamSettings)),
    (AllowanceTable, (Allowance,)),
]
"""The tables of the file, and the objects that take their keys as arguments."""

OTHER_KEYS = {
    tables.EnsembleTable: {
        "agents": "the agents of a team that have it",
        "discount": "of rewards, in place of the model's",
        "durations": "those of the policy's model, for who looks at the file",
        "drift": "what watches the ensemble's model, an actor of its own",
        "placement": "a table of its own",
        "policy_kind": "how the policy's file is read",
        "search": "a table of its own",
        "shield": "a table of its own",
    },
    tables.ActionTable: {
        "call": "the target, a function",
        "navigate": "what the function is given",
        "ensemble": "the target, an ensemble",
        "place": "the target, a place of the map",
        "way": "the target, a way of the map",
    },
    tables.RestartTable: {"restart": "the argument limit, by the name of the supervision"},
    PlacesTable: {
        "building": "a file of several floors",
        "navigator": "a function that makes it",
        "pose": "of an extension",
    },
    TeamTable: {
        "access": "the folder of certificates, of which each agent takes its own",
        "allowance": "a table of its own",
        "port": "the first of the endpoints",
    },
}
"""The keys that no argument has by their name, and the reason."""


def arguments_of(makers):
    return {
        name
        for maker in makers
        for name in getattr(maker, "__struct_fields__", None) or inspect.signature(maker).parameters
    }


@pytest.mark.parametrize(("table", "makers"), TAKEN_BY)
def test_every_key_is_an_argument_or_says_why_it_is_none(table, makers):
    assert {*table.__struct_fields__} - arguments_of(makers) == {*OTHER_KEYS.get(table, ())}


@pytest.mark.parametrize(("table", "makers"), TAKEN_BY)
def test_what_a_key_is_by_default_is_said_by_that_which_takes_it_alone(table, makers):
    taken = arguments_of(makers)
    bases = [maker for maker in makers if maker in table.__mro__]
    declared = {field.name: field.default for base in bases for field in fields_of(base)}
    for field in fields_of(table):
        if field.name in declared:
            assert field.default == declared[field.name], field.name
        elif field.name in taken - {"plans", "supervision", "local"}:  # a search's; an actor's own; a flag
            assert field.default in {None, msgspec.NODEFAULT}


def fields_of(struct):
    return msgspec.structs.fields(struct)


def test_what_was_not_written_is_as_the_options_say():
    table = tables.ActionTable(call="robot:go", grace=2.0, resume=True)
    assert table.as_arguments(BindingSettings) == msgspec.structs.asdict(BindingSettings(grace=2.0, resume=True))
