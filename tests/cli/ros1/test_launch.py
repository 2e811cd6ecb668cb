"""Launch files, with the forms that packages of the original use."""

from __future__ import annotations

import pytest
from cli.ros1 import packages

from mdm import Error
from mdm.cli.ros1.launch import read_launch, roots


def nodes(tmp_path, text, **files):
    package = packages.write(tmp_path / "robot", {"launch/main.launch": text, **files})
    return {node.name: node for node in read_launch(package / "launch/main.launch", package).nodes}


def test_namespaces_and_remappings(tmp_path):
    found = nodes(
        tmp_path,
        """<launch><remap from="a" to="x"/><group ns="one"><remap from="b" to="/y"/>
        <node pkg="robot" type="t" name="in" ns="two"><remap from="c" to="z"/></node></group>
        <node pkg="robot" type="t" name="out"/></launch>""",
    )
    assert [found["in"].topic(name) for name in "abcd"] == ["/one/two/x", "/y", "/one/two/z", "/one/two/d"]
    assert [found["out"].topic(name) for name in "abc"] == ["/x", "/b", "/c"]


def test_arguments_conditions_and_defaults(tmp_path):
    found = nodes(
        tmp_path,
        """<launch><arg name="n" default="3"/><arg name="on" value="true"/>
        <node pkg="robot" type="t" name="a" args="$(arg n) 'two words' $(optenv HOUSE red) $(anon b)" if="$(arg on)"/>
        <node pkg="robot" type="t" name="b" unless="$(arg on)"/>
        <node pkg="robot" type="t" name="c" if="0"/></launch>""",
    )
    assert list(found) == ["a"]
    assert found["a"].arguments == ["3", "two words", "red", "b"]
    assert found["a"].place.endswith("main.launch:2")


def test_folders_and_parameters_in_yaml(tmp_path):
    found = nodes(
        tmp_path,
        """<launch><include file="$(dirname)/more/part.launch.xml" ns="in"/></launch>""",
        **{
            "launch/more/part.launch.xml": """<launch><node pkg="robot" type="t" name="a" args="$(dirname)">
            <rosparam>
              decision_period: 0.5   # seconds
              is_sparse: true
            </rosparam></node></launch>"""
        },
    )
    assert found["a"].arguments == [str(tmp_path / "robot" / "launch" / "more")]
    assert found["a"].namespace == "/in"
    assert found["a"].parameters == {"decision_period": "0.5", "is_sparse": "true"}


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "<launch><arg name='a' value='xx'/>" + "<arg name='a' value='$(arg a)$(arg a)'/>" * 60 + "</launch>",
            "becomes longer than 100,000 characters",
        ),
        ("<launch>" + "<include file='$(find robot)/launch/b.launch'/>" * 40 + "</launch>", "more than 1,000 includes"),
    ],
)
def test_what_grows_without_bound_is_refused(tmp_path, text, told):
    other = "<launch>" + "<include file='$(find robot)/launch/c.launch'/>" * 40 + "</launch>"
    with pytest.raises(Error, match=told):  # which of the files is told by its path
        nodes(tmp_path, text, **{"launch/b.launch": other, "launch/c.launch": "<launch></launch>"})


def test_what_is_included_is_no_root(tmp_path):
    package = packages.rounds(tmp_path)
    assert [path.name for path in roots(package)] == ["robot.launch"]
