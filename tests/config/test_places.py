"""The table `places` of a file: the map's places as predicates, its ways as actions."""

from __future__ import annotations

import asyncio
import sys
from typing import ClassVar

import pytest
import team_file as team
from building_file import write_building
from loading import written
from sentences import refused

from mdm import ConfigError, Error, Extension, load_system
from mdm.config import TableReader
from mdm.config.builder import look_over
from mdm.maps import Pose
from mdm.messages import Heading
from mdm.testing import capture_decisions, probe, run_virtual

GRAPH = """{"type": "FeatureCollection", "features": [
{"type": "Feature", "properties": {"id": 1, "frame": "map", "metadata": {"name": "Hall"}},
 "geometry": {"type": "Point", "coordinates": [2.0, 2.0]}},
{"type": "Feature", "properties": {"id": 2, "frame": "map", "metadata": {"name": "Kitchen"}},
 "geometry": {"type": "Point", "coordinates": [6.0, 2.0]}},
{"type": "Feature", "properties": {"id": 3, "startid": 1, "endid": 2, "metadata": {"name": "Right"}},
 "geometry": {"type": "MultiLineString", "coordinates": [[[2.0, 2.0], [6.0, 2.0]]]}},
{"type": "Feature", "properties": {"id": 4, "startid": 2, "endid": 1, "metadata": {"name": "Left"}},
 "geometry": {"type": "MultiLineString", "coordinates": [[[6.0, 2.0], [2.0, 2.0]]]}}]}
"""

ROBOT = """
import asyncio
goals = []
class Wheels:
    async def go(self, goal):
        goals.append(goal.x)
        await asyncio.sleep(1000)
def choose(which):
    return Wheels()
def kind():
    return Wheels
class Broken:
    def __init__(self):
        raise OSError("no wheels")
async def localise(system):
    from mdm.maps import Pose
    for x in (2.0, 2.0, 6.0):
        system.places.see(Pose(x, 2.0))
        await asyncio.sleep(0.4)
"""

STUCK = """
import asyncio
begun = []
class Stuck:
    async def go(self, goal):
        begun.append(asyncio.get_running_loop().time())
        await asyncio.sleep(2.0)
        raise OSError("a chair is in the way")
"""

FILE = """
tasks = ["wheels:localise"]

[places]
graph = "floor.geojson"
reach = 1.5
prefix = "In"
navigator = "wheels:Wheels"

[predicates]
Cooks = "InKitchen and not InHall.at_goal"

[ensembles.robot]
policy = [0, 1]

[ensembles.robot.states]
place = { predicates = ["InHall", "InKitchen"] }

[ensembles.robot.actions]
Right = { way = "Right" }
Home = { place = "Hall", timeout = 60.0 }
"""


def file(tmp_path, text=FILE):
    (tmp_path / "floor.geojson").write_text(GRAPH)
    (tmp_path / "wheels.py").write_text(ROBOT)
    return written(tmp_path, text, "robot.toml")


def problems(tmp_path, text, **options):
    with pytest.raises(ConfigError) as caught:
        load_system(file(tmp_path, text), **options)
    return [(problem.key, problem.message) for problem in caught.value.problems]


def test_ways_and_places_say_what_their_ends_are_followed_by(tmp_path):
    text = FILE.replace('way = "Right"', 'way = "Right", then = "decide", pause = 2.0')
    text = text.replace("timeout = 60.0", "attempts = 3")
    right, home = load_system(file(tmp_path, text)).ensembles["robot"].action.bindings
    assert [(b.sequel.then, b.sequel.pause, b.sequel.attempts) for b in (right, home)] == [
        ("decide", 2.0, None),
        (None, 1.0, 3),
    ]


@pytest.mark.parametrize(("then", "begun"), [("", [0.0, 3.0, 7.0, 13.0]), (', then = "wait"', [0.0])])
@pytest.mark.parametrize("target", ['way = "Right"', 'place = "Kitchen"'])
def test_a_drive_of_a_file_that_fails_is_decided_again_unless_it_says_otherwise(tmp_path, target, then, begun):
    text = FILE.replace('["wheels:localise"]', "[]").replace("wheels:Wheels", "wheels:Stuck")
    text = text.replace('way = "Right"', target + then)
    folder = file(tmp_path, text)
    (tmp_path / "wheels.py").write_text(STUCK)
    system = load_system(folder)

    async def main(runtime):
        await runtime.start(system)
        for _ in range(160):
            system.places.see(Pose(2.0, 2.0))
            await asyncio.sleep(0.1)

    run_virtual(main)
    assert sys.modules["wheels"].begun == begun


def test_places_are_predicates_and_ways_are_actions(tmp_path):
    system = load_system(file(tmp_path))
    right, home = system.ensembles["robot"].action.bindings
    assert (right.on_repeat, right.timeout, home.on_repeat, home.timeout) == ("restart", None, "continue", 60.0)

    async def main(runtime):
        with capture_decisions(runtime) as decisions:
            await runtime.start(system)
            await asyncio.sleep(1.2)
        assert [decision.action_name for decision in decisions] == ["Right", "Home"]
        assert system.predicates.value("Cooks") is True
        await asyncio.sleep(0.2)
        assert system.predicates.value("InKitchen") is None

    run_virtual(main)
    assert sys.modules["wheels"].goals == [6.0, 2.0]


@pytest.mark.parametrize(("max_age", "tolerance"), [(3.0, 1.2), (1.5, 0.4)])
def test_each_key_of_the_table_counts(tmp_path, max_age, tolerance):
    keys = f'margin = 0.0\nmax_age = {max_age}\ntolerance = {tolerance}\noutside = "keep"\n'
    text = FILE.replace("[predicates]", f"{keys}\n[predicates]").replace('["wheels:localise"]', "[]")
    system = load_system(file(tmp_path, text))

    async def main(runtime):
        await runtime.start(system)
        for distance, arrived in ((tolerance - 0.1, True), (tolerance + 0.1, False)):
            system.places.see(Pose(2.0, 2.0 + distance))
            assert system.predicates.value("InHall.at_goal") is arrived
        for _ in range(4):
            await asyncio.sleep(1.0)
            system.places.see(Pose(4.0, 2.0))  # between the places
        assert system.places.place == "Hall"
        system.places.see(Pose(4.55, 2.0))
        assert system.places.place == "Kitchen"
        await asyncio.sleep(max_age - 0.1)
        assert system.places.place == "Kitchen"
        await asyncio.sleep(0.2)
        assert system.places.place is None

    run_virtual(main)


def test_the_margin_of_the_table_counts(tmp_path):
    text = FILE.replace("reach = 1.5", "reach = 5.0\nmargin = 1.0").replace('["wheels:localise"]', "[]")
    system = load_system(file(tmp_path, text))

    async def main(runtime):
        await runtime.start(system)
        for x, place in ((2.0, "Hall"), (4.9, "Hall"), (5.1, "Kitchen")):
            system.places.see(Pose(x, 2.0))
            assert system.places.place == place

    run_virtual(main)


def test_without_a_navigator_there_are_places_alone(tmp_path):
    text = FILE.replace('navigator = "wheels:Wheels"\n', "").replace('{ way = "Right" }', '"wheels:Wheels"')
    text = text.replace('{ place = "Hall", timeout = 60.0 }', '"wheels:Wheels"')
    system = load_system(file(tmp_path, text), callbacks=False)
    assert system.places.prefix == "In"
    assert system.places.labels.name(2, 2) == "Hall"


@pytest.mark.parametrize("look", [True, False])
def test_a_file_is_checked_without_its_code(tmp_path, look):
    system = look_over(file(tmp_path)) if look else load_system(file(tmp_path), callbacks=False)
    assert system.predicates.declared.knows("InHall.arrived") == "event"
    with refused(Error):
        system.places.see(Pose(1, 1))


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ('graph = "floor.geojson"', 'graph = "none.geojson"', "places", "none.geojson"),
        ('graph = "floor.geojson"\n', "", "places", "the required key 'graph' is missing"),
        ('prefix = "In"', "margins = 1.0", "places.margins", "there is no key 'margins' here; did you mean 'margin'"),
        ("reach = 1.5", "reach = 1.5\nmargin = 4.0", "places", "could not be entered"),
        ('"wheels:Wheels"', '"wheels:Broken"', "places.navigator", "cannot be made: OSError: no wheels"),
        ('"wheels:Wheels"', '"wheels:Feet"', "places.navigator", "has no 'Feet'"),
        (
            '"wheels:Wheels"',
            '"wheels:localise"',
            "places.navigator",
            "cannot be made: it is an async function",
        ),
        ('"wheels:Wheels"', '"wheels:choose"', "places.navigator", "cannot be made: TypeError"),
        ('"wheels:Wheels"', '"wheels:kind"', "places.navigator", "an object, not its class: give Wheels("),
        ('graph = "floor.geojson"', 'graph = "a\\u0000b"', "places", "the path of a file was expected"),
        ('graph = "floor.geojson"', 'graph = ""', "places", "the path of a file was expected"),
        ('way = "Right"', 'way = "Up"', "ensembles.robot.actions.Right", "no way is called 'Up'; there are 'Right'"),
        ('place = "Hall"', 'place = "Cellar"', "ensembles.robot.actions.Home", "there is no place 'Cellar'"),
        (
            'way = "Right"',
            'way = "Right", call = "a:b"',
            "ensembles.robot.actions.Right",
            "'call' means nothing beside",
        ),
        ('navigator = "wheels:Wheels"\n', "", "ensembles.robot.actions.Right", "a way needs a navigator to drive"),
        ("[predicates]", "[predicates]\nInHall = {}", "predicates.InHall", "'InHall' is declared twice"),
        ("[ensembles.robot]", "[ensembles.places]", "ensembles.places", "cannot be called 'places' beside a map"),
    ],
)
def test_what_is_wrong_is_told_with_its_key(tmp_path, old, new, key, words):
    assert old in FILE
    found = problems(tmp_path, FILE.replace(old, new))
    assert any(place == key and words in message for place, message in found), found


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ('graph = "floor.geojson"', 'graph = "none.geojson"', "places"),
        ('prefix = "In"', "margins = 1.0", "places.margins"),
        ("reach = 1.5", "reach = 1.5\nmargin = 4.0", "places"),
    ],
)
def test_all_else_is_checked_beside_a_map_that_is_wrong_but_for_its_names(tmp_path, old, new, key):
    text = FILE.replace(old, new).replace("[0, 1]", '"none.npz"').replace("timeout = 60.0", "timeout = -1.0")
    text += '\n[predicates.Late]\nformula = "Cooks and"\n'
    found = {place for place, _ in problems(tmp_path, text)}
    assert found == {key, "predicates.Late", "ensembles.robot.actions.Home.timeout", "ensembles.robot.policy"}


def test_ways_and_names_are_checked_beside_a_navigator_that_is_wrong(tmp_path):
    text = FILE.replace("wheels:Wheels", "wheels:Broken").replace('way = "Right"', 'way = "Up"')
    found = problems(tmp_path, text.replace("InKitchen and", "Kitchen and"))
    assert {place for place, _ in found} == {
        "places.navigator",
        "ensembles.robot.actions.Right",
        "predicates.Cooks",
    }


NAVIGATORS = 'navigator = { a = "wheels:Wheels", b = "wheels:Broken" }'


def of_a_team(tmp_path, old=NAVIGATORS, new=NAVIGATORS):
    """Write a team's file of which each agent has a navigator, with a replacement."""
    file(tmp_path)
    places = f'[places]\ngraph = "floor.geojson"\nreach = 1.5\n{NAVIGATORS}\n\n[predicates]'
    changes = [("[predicates]", places), ('"team_code:go"', '{ place = "Kitchen" }'), (old, new)]
    return team.write(tmp_path, ('["team_code:sense"]', "[]"), *changes)


def test_in_a_team_s_file_each_agent_may_have_a_navigator_of_its_own(tmp_path):
    path = of_a_team(tmp_path)
    go = load_system(path, agent="a").ensembles["joint"].action.bindings[1]
    assert go.target.__qualname__ == "Navigation.go_to('Kitchen')"
    with refused(ConfigError):
        load_system(path, agent="b")


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        ("b = ", "bob = ", "places.navigator", "has no agent 'bob'"),
        (', b = "wheels:Broken"', "", "ensembles.joint.actions.go", "a place needs a navigator to drive there"),
    ],
)
def test_navigators_of_no_agent_or_not_of_this_one_are_refused(tmp_path, old, new, key, words):
    path = of_a_team(tmp_path, NAVIGATORS, NAVIGATORS.replace(old, new))
    with pytest.raises(ConfigError) as caught:
        load_system(path, agent="b")
    assert any(problem.key == key and words in problem.message for problem in caught.value.problems)


def test_a_navigator_per_agent_is_for_a_team(tmp_path):
    found = problems(tmp_path, FILE.replace('"wheels:Wheels"', '{ ada = "wheels:Wheels" }'))
    assert any(key == "places.navigator" and "for a team's file" in message for key, message in found)


class Beacon(TableReader):
    """Reads a table `beacon`, poses with a light, and navigators."""

    entries: ClassVar = {"pose": frozenset({"light"})}

    def pose(self, written, places, key):
        self.see = lambda: places.see(Pose(*written["light"]))

    def navigator(self, written, key):
        if written["power"] < 1:
            raise ConfigError("it does not drive so")
        self.driven = Driven()
        return self.driven

    def extension(self):
        return Shining(self)


class Driven:
    """Notes goals."""

    def __init__(self):
        self.goals = []

    async def go(self, goal):
        self.goals.append(goal.x)
        await asyncio.Event().wait()


class Shining(Extension):
    """Tells the pose at the first change of an actor that begins."""

    def __init__(self, reader):
        self.reader = reader

    def on_change(self, change):
        if change.actor == "places" and change.state == "running":
            asyncio.get_running_loop().call_later(1.0, self.reader.see)


LIGHT = "pose = { light = [6.0, 2.0] }\nnavigator = { beacon = { power = 3 } }"
DRIVEN = FILE.replace('navigator = "wheels:Wheels"', LIGHT).replace('["wheels:localise"]', "[]")
BEACON = {"beacon": Beacon}


def test_an_extension_tells_the_pose_and_drives(tmp_path):
    system = load_system(file(tmp_path, f"beacon = {{}}\n{DRIVEN}"), tables=BEACON)

    async def main(runtime):
        await runtime.start(system)
        await asyncio.sleep(1.2)

    run_virtual(main)
    assert system.extensions[0].reader.driven.goals == [2.0]  # in the kitchen the robot drives home to the hall


@pytest.mark.parametrize(
    ("old", "new", "key", "words"),
    [
        (
            "beacon = {}",
            "",
            "places.pose",
            "'light' is a key of the extension 'beacon': give the file a table [beacon]",
        ),
        ("beacon = {}", "", "places.navigator", "'beacon' is an extension: give the file a table [beacon]"),
        ("light", "smoke", "places.pose", "no extension of this file has these keys"),
        ("power = 3", "power = 0", "places.navigator", "it does not drive so"),
        ("{ beacon =", "{ radio =", "places.navigator", "for a team's file"),
    ],
)
def test_poses_and_navigators_of_no_extension_are_refused(tmp_path, old, new, key, words):
    found = problems(tmp_path, f"beacon = {{}}\n{DRIVEN}".replace(old, new), tables=BEACON)
    assert any(at == key and words in message for at, message in found), found
    assert {at for at, _ in found} <= {"places.pose", "places.navigator"}


def test_an_agent_of_a_team_may_be_driven_by_an_extension(tmp_path):
    path = of_a_team(tmp_path, '"wheels:Broken"', "{ beacon = { power = 3 } }")
    text = f"beacon = {{}}\n{path.read_text()}"
    go = load_system(written(tmp_path, text), agent="b", tables=BEACON).ensembles["joint"].action.bindings[1]
    assert go.target.__qualname__ == "Navigation.go_to('Kitchen')"
    path.write_text(text.replace("{ beacon = { power = 3 } }", "3"))
    with refused(ConfigError):
        load_system(path, agent="b", tables=BEACON)


def test_a_tour_is_of_the_places(tmp_path):
    path = file(tmp_path, FILE.replace('prefix = "In"\n', 'prefix = "In"\ntour = ["Hall", "Kitchen"]\n'))
    system = load_system(path)

    async def main(runtime):
        await runtime.start(system)
        await asyncio.sleep(0.2)
        assert system.predicates.value("InKitchen.next") is True

    run_virtual(main)
    found = problems(tmp_path, FILE.replace('prefix = "In"\n', 'prefix = "In"\ntour = ["Hall", "Attic"]\n'))
    assert any(key.startswith("places") and "the tour comes to 'Attic'" in message for key, message in found)


SITE = """[floors.ground]
map = "ground/map.yaml"
graph = "ground/graph.xml"
labels = "ground/labels.ppm"
[floors.upper]
map = "upper/map.yaml"
graph = "upper/graph.xml"
labels = "upper/labels.ppm"
[lifts.lift]
stops = ["ground.store", "upper.store"]
seconds = 12.0
"""
FLOORS = """
[places]
building = "building.toml"
navigator = "wheels:Wheels"
[ensembles.robot]
policy = [0, 1, 0, 0, 0, 0]
[ensembles.robot.states.place]
"ground.hall" = "ground.hall.reached"
"ground.office" = "ground.office.reached"
"ground.store" = "ground.store.reached"
"upper.hall" = "upper.hall.reached"
"upper.office" = "upper.office.reached"
"upper.store" = "upper.store.reached"
[ensembles.robot.actions]
Up = { way = "lift to upper" }
Home = { place = "upper.hall" }
"""


def test_a_building_has_the_places_of_all_its_floors(tmp_path):
    write_building(tmp_path, SITE)
    path = file(tmp_path, FLOORS)
    (tmp_path / "wheels.py").write_text(
        ROBOT.replace("class Broken", "    def ride(self, lift, goal): ...\nclass Broken")
    )
    system = load_system(path, callbacks=False)

    async def main(runtime):
        await runtime.start(system)
        system.places.see(Pose(2.0, 3.5, floor="upper"))
        await asyncio.sleep(0.1)
        assert system.predicates.value("upper.store.reached") is True

    run_virtual(main)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('building = "building.toml"', "", "the required key 'graph' is missing; or give 'building'"),
        ('navigator = "wheels', 'reach = 1.0\nnavigator = "wheels', "names the files of its floors: leave reach out"),
        ('"building.toml"', '"no.toml"', "no.toml: there is no such file"),
        ('"building.toml"', '""', "the path of a file was expected, not ''"),
        ("navigator", "prefix", "a place needs a navigator to drive there"),
        ("", "", "the navigator has no async method 'ride'"),
    ],
)
def test_a_building_that_is_none_is_told(tmp_path, before, after, words):
    write_building(tmp_path, SITE)
    found = problems(tmp_path, FLOORS.replace(before, after) if before else FLOORS)
    assert any(words in message for _, message in found), found


FETCH = """
async def fetch(navigate):
    begun.append("fetch")
    await navigate("Kitchen")
async def dance(): ...
begun = []
"""


def with_fetch(tmp_path, fetch, text=FILE):
    path = file(tmp_path, text.replace('{ way = "Right" }', fetch))
    (tmp_path / "arm.py").write_text(FETCH)
    return path


def test_a_function_drives_by_its_argument_navigate(tmp_path):
    path = with_fetch(tmp_path, '{ call = "arm:fetch", navigate = true, timeout = 30.0 }')
    for system in (load_system(path), load_system(path, callbacks=False), look_over(path)):
        fetch = system.ensembles["robot"].action.bindings[0]
        assert (fetch.timeout, fetch.retries, fetch.lasts) == (30.0, True, True)  # alike in a replay
    system = load_system(path)

    async def main(runtime):
        await runtime.start(system)
        told = probe(runtime.channel("navigation/headings", Heading))
        await asyncio.sleep(0.3)
        return [(heading.target, heading.why) for heading in told]

    assert run_virtual(main) == [("Kitchen", "an action goes there, to work")]
    assert sys.modules["wheels"].goals[-1] == 6.0


@pytest.mark.parametrize(
    ("fetch", "text", "words"),
    [
        ('{ call = "arm:dance", navigate = true }', FILE, "dance needs an argument 'navigate' to drive by"),
        ('{ way = "Right", navigate = true }', FILE, "'navigate' means nothing beside a way"),
        (
            '{ call = "arm:fetch", navigate = true }',
            FILE.replace('navigator = "wheels:Wheels"\n', "").replace(
                '{ place = "Hall", timeout = 60.0 }', '"arm:dance"'
            ),
            "'navigate' needs a navigator",
        ),
    ],
)
def test_what_could_not_navigate_is_refused(tmp_path, fetch, text, words):
    path = with_fetch(tmp_path, fetch, text)
    for load in (load_system, look_over):
        with pytest.raises(ConfigError) as caught:
            load(path)
        assert words in str(caught.value)


def test_functions_of_one_group_replace_each_other_without_a_stop(tmp_path):
    grouped = '{{ call = "arm:dance", group = "{}" }}'
    text = FILE.replace('{ place = "Hall", timeout = 60.0 }', grouped.format("base"))
    one, other = load_system(with_fetch(tmp_path, grouped.format("base"), text)).ensembles["robot"].action.bindings
    assert one.group == other.group is not None
    one, other = load_system(with_fetch(tmp_path, grouped.format("arm"), text)).ensembles["robot"].action.bindings
    assert one.group is not other.group
