"""Packages in the form of the original's, written for the tests: an MDP over a map, a POMDP on events, a hierarchy."""

from __future__ import annotations

import shutil

from places import EXAMPLES

HEAD = "#include <ros/ros.h>\nusing namespace std;\nusing namespace ros;\n"


def write(folder, files):
    """Write files by their paths."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def main(body, before=""):
    begin = "int main ( int argc, char** argv )"
    return f'{HEAD}{before}\n{begin}\n{{\n  init ( argc, argv, "layer" );\n{body}\n  spin();\n}}\n'


GRAPH = """<TopologicalMap>
  <Node name="InHall"><Goal>2.0 3.0 0.0</Goal>
    <Connections><Connection label="Right">InOffice</Connection></Connections></Node>
  <Node name="InOffice"><Goal>6.0 3.0 0.0</Goal>
    <Connections><Connection label="Left">InHall</Connection></Connections></Node>
</TopologicalMap>
"""


def rounds(folder):
    """An MDP over a map: a robot that goes to and fro, and has two helpers of predicates."""
    return write(
        folder / "rounds",
        {
            "CMakeLists.txt": "add_executable ( layers src/state.cpp )  # states\nadd_executable(move src/move.cpp)\n",
            "config/map.xml": GRAPH,
            "config/policy": "[4](1,1,0,0)",
            "launch/robot.launch": """<launch>
  <arg name="policy" default="policy"/>
  <group ns="robot">
    <node pkg="rounds" type="layers" name="state_layer"/>
    <node pkg="rounds" type="predicates" name="predicates"/>
    <node pkg="rounds" type="control" name="control" args="$(find rounds)/config/$(arg policy)">
      <param name="decision_horizon" value="50"/>
      <param name="is_sparse" value="true"/>
    </node>
    <include file="$(find rounds)/launch/move.launch"><arg name="map" value="map.xml"/></include>
    <node pkg="rviz" type="rviz" name="rviz" args="$(env HOME)/robot.rviz" if="$(arg shown)"/>
  </group>
</launch>
""",
            "launch/move.launch": """<launch>
  <arg name="map"/>
  <node pkg="rounds" type="move" name="action_layer" args="$(find rounds)/config/$(arg map)"/>
</launch>
""",
            "src/state.cpp": main(
                """
  StateLayer layer;
  // layer.addStateFactor ( StateDep().add ( "InNowhere" ) );
  layer.addStateFactor ( StateDep().add ( "InHall" )
                         .add ( "InOffice" ) );
  layer.addStateFactor ( StateDep().add ( "IsLate" ) );"""
            ),
            "src/control.cpp": main("  string path = argv[1];\n  ControllerEventMDP cl ( path );"),
            "src/move.cpp": main(
                """
  string map = argv[1];
  TopologicalMoveBaseActionLayer al ( map );
  al.addAction ( "Left" ); /* the first */ al.addAction ( "Right" );"""
            ),
            "src/predicates.cpp": main(
                """
  PredicateManager pm;
  TopologicalPredicate hall ( "pose_label", "InHall" );
  TopologicalPredicate office ( "pose_label", "InOffice" );
  Clock clock;
  PropLogicPredicate late ( "IsLate", And ( PV ( "IsNight" ), Not ( Or ( PV ( "InHall" ), "IsFree" ) ) ) );
  PropLogicEvent free ( "BecameFree", Implies ( PV ( "IsNight" ), PV ( "IsFree" ) ) );
  IsFreePredicate is_free;
  Odd odd ( 3 );
  pm.addPredicate ( hall );
  pm.addPredicate ( office );
  pm.addPredicate ( clock );
  pm.addPredicate ( late );
  pm.addPredicate ( is_free );
  pm.addEvent ( free );
  pm.addPredicate ( *make_one() );""",
                """
class Clock : public Predicate
{
public:
  Clock() : Predicate ( "IsNight" ) {}
  void update() { setValue ( hour() > 20 ); }
};
class IsFreePredicate : public Predicate
{
public:
  IsFreePredicate() : Predicate ( "IsFree", Dependencies().add ( "InHall" ).add ( "InOffice" ) ) {}
  void update()
  {
    if ( getValue() ) { if ( getDependencyValue ( "InOffice" ) ) setValue ( false ); }
    else { if ( getDependencyValue ( "InHall" ) ) setValue ( true ); }
  }
};""",
            ),
        },
    )


ROUNDS = """
tasks = ["robot:live"]
[places]
graph = "map.xml"
reach = 1.0
navigator = "robot:Navigator"
[predicates]
IsNight = {}
IsFree = { set = "InHall", reset = "InOffice", initial = false }
IsLate = "IsNight and not (InHall or IsFree)"
[ensembles.robot]
policy = [1, 1, 0, 0]
horizon = 50
[ensembles.robot.states]
place = ["InHall", "InOffice"]
late = ["IsLate"]
[ensembles.robot.actions]
Left = { way = "Left" }
Right = { way = "Right" }
"""


def door(folder):
    """A POMDP on events, at a fixed rate: the example of the tiger."""
    package = write(
        folder / "door",
        {
            "launch/door.launch": """<launch>
  <param name="decision_period" value="0.5"/>
  <node pkg="door" type="control" name="listener_control_layer"
        args="$(find door)/problem/tiger.pomdp $(find door)/problem/tiger.vf"/>
  <node pkg="door" type="ears" name="ears"/>
  <node pkg="door" type="hands" name="hands"/>
</launch>
""",
            "src/control.cpp": main("  ControllerTimedPOMDP control ( argv[1], string ( argv[2] ) );"),
            "src/ears.cpp": main(
                """
  ObservationLayer ol;
  ObservationDep dep;
  dep.add ( "HearLeft" ).add ( "HearRight" );
  ol.addObservationFactor ( ObservationDep().add ( "HearLeft" ).add ( "HearRight" ) );"""
            ),
            "src/hands.cpp": main(
                """
  Hands hands;
  ActionLayer al;
  al.addAction ( boost::bind ( &Hands::listen, &hands ) );
  al.addAction ( "open-left", boost::bind ( &Hands::openLeft, &hands ) );
  al.addAction ( &open_right );""",
                """
class Hands { public:
  void listen() { ROS_INFO ( "listening" ); }
  void openLeft() { door_.open ( 0 ); }
};
void open_right () { }""",
            ),
        },
    )
    (package / "problem").mkdir()
    for name in ("tiger.pomdp", "tiger.vf"):
        shutil.copyfile(EXAMPLES / name, package / "problem" / name)
    return package


def levels(folder):
    """A hierarchy: one level starts and stops the other by services."""
    return write(
        folder / "levels",
        {
            "launch/levels.launch": """<launch>
  <node pkg="levels" type="top_states" name="top_states"/>
  <node pkg="levels" type="top_control" name="top_control" args="$(find levels)/top"/>
  <node pkg="levels" type="top_actions" name="top_actions"/>
  <group ns="patrol">
    <node pkg="levels" type="low_states" name="states"/>
    <node pkg="levels" type="low_control" name="control" args="$(find levels)/low"/>
    <node pkg="levels" type="low_actions" name="actions"/>
  </group>
</launch>
""",
            "top": "[2](0,1)",
            "low": "[2](1,0)",
            "src/top_states.cpp": main('  StateLayer sl;\n  sl.addStateFactor ( StateDep().add ( "Called" ) );'),
            "src/low_states.cpp": main('  StateLayer sl;\n  sl.addStateFactor ( StateDep().add ( "AtEnd" ) );'),
            "src/top_control.cpp": main("  ControllerEventMDP cl ( argv[1] );"),
            "src/low_control.cpp": main("  ControllerEventMDP cl ( argv[1], STOPPED );"),
            "src/top_actions.cpp": main(
                """
  Actions all;
  ActionLayer al;
  al.addAction ( boost::bind ( &Actions::patrol, &all ) );
  al.addAction ( boost::bind ( &Actions::answer, &all ) );""",
                """
class Actions {
public:
  Actions() : start_ ( nh_.serviceClient<std_srvs::Empty> ( "patrol/start" ) ),
              stop_ ( nh_.serviceClient<std_srvs::Empty> ( "patrol/stop" ) ) {}
  void patrol() { std_srvs::Empty e; start_.call ( e ); }
  void answer() { std_srvs::Empty e; stop_.call ( e ); say ( "hello" ); }
private:
  NodeHandle nh_;
  ServiceClient start_, stop_;
};""",
            ),
            "src/low_actions.cpp": main(
                """
  ActionLayer al;
  al.addAction ( &go );
  al.addAction ( &come_back );""",
                "void go () {}\nvoid come_back () {}",
            ),
        },
    )


LEVELS = """
[predicates]
Called = {}
AtEnd = {}
[ensembles.top]
policy = [0, 1]
[ensembles.top.states]
called = ["Called"]
[ensembles.top.actions]
patrol = { ensemble = "patrol" }
answer = "robot:answer"
[ensembles.patrol]
policy = [1, 0]
[ensembles.patrol.states]
end = ["AtEnd"]
[ensembles.patrol.actions]
go = "robot:go"
come_back = "robot:come_back"
"""
