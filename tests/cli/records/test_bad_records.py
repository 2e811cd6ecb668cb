"""Records that are none or cannot be used, and files that cannot be written: a sentence names each and its way out."""

from __future__ import annotations

import importlib
import importlib.util
import os
import shutil
import sys

import pytest
from mcap.writer import Writer
from places import EXAMPLES
from records import HEAD, Writing, decision, official, written

from mdm.messages import Control
from mdm.recording.process import File
from mdm.recording.reader import Record

VERBS = [
    "record info FILE",
    "record cat FILE",
    "record cat FILE --stimuli",
    "record export FILE -o OUT.csv",
    "record repair FILE -o OUT.mcap",
    "replay FILE",
    "replay FILE --config tiger.toml",
    "explain FILE --at 1",
    "statistics FILE --model tiger.pomdp",
    "plot run FILE -o OUT.png",
]

CAUSES = {
    "text": "is not an MCAP file, so it cannot be a record",
    "empty": "the file is empty",
    "foreign": "this file of another program (rosbag2) is not a record of mdm",
    "newer": "the record has format 2, of a newer mdm (0.9.0): this one reads formats up to 1",
    "headless": "the file ends before the head of the record: nothing of the run is in it",
    "missing": "there is no such file",
    "pipe": "this is a pipe or a device, not a file: save its content to a file first",
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    for name in ("tiger.pomdp", "tiger.vf", "tiger.toml", "tiger.py"):
        shutil.copy(EXAMPLES / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # for the folder's content is compared
    sys.modules.pop("tiger", None)  # of another folder, where another test has loaded it
    yield tmp_path
    sys.modules.pop("tiger", None)


def make(cause, path):
    """Make a file of which a verb is to say a sentence."""
    if cause == "text":
        path.write_text("decision,action\n1,2\n")
    elif cause == "empty":
        path.touch()
    elif cause == "foreign":
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(library="rosbag2")
            writer.add_message(writer.register_channel("/tf", "cdr", 0), 1, b"\0", 1, 0)
            writer.finish()
    elif cause == "newer":
        written(path, [("decisions", decision(1))], HEAD | {"format": "2", "mdm": "0.9.0"})
    elif cause == "headless":
        path.write_bytes(written(path, [("decisions", decision(1))]).read_bytes()[:40])
    elif cause == "pipe":
        os.mkfifo(path)


def assert_told(result, *sentences, status=1):
    found, output, errors = result
    assert (found, output) == (status, []), errors
    assert len(errors.splitlines()) == 1 or status == 2
    for sentence in sentences:
        assert sentence in errors
    assert "Traceback" not in errors
    assert "unexpected" not in errors


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("verb", VERBS)
def test_what_is_no_record(mdm, folder, verb, cause):
    path = folder / "given.mcap"
    make(cause, path)
    before = sorted(folder.iterdir())
    assert_told(mdm(*verb.replace("FILE", str(path)).split()), str(path), CAUSES[cause])
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("verb", [verb for verb in VERBS if not verb.startswith("replay")])
def test_a_folder_is_no_record(mdm, folder, verb):
    assert_told(mdm(*verb.replace("FILE", str(folder)).split()), f"{folder}: this is a folder, not a file")


def test_a_folder_without_records_is_no_teams(mdm, folder):
    assert_told(mdm("replay", folder), f"{folder}: there are no records in this folder: mdm team up --record")


def test_a_record_without_a_start_is_not_replayed(mdm, folder):
    path = written(folder / "run.mcap", [("decisions", decision(1))])
    assert_told(mdm("replay", path), f"{path}: the record has no beginning")


def test_a_record_without_a_configuration_asks_for_one(mdm, folder):
    path = folder / "run.mcap"
    assert mdm("run", "tiger.toml", "--virtual", "--epochs", 3, "--record", path)[0] == 0
    bare = rewritten(path, folder / "bare.mcap", head=lambda head: {**head, "configuration": None})
    assert_told(mdm("replay", bare), f"{bare}: the record has no configuration", "with --config")


def rewritten(path, target, *, head=dict, attachment=lambda attached: attached):
    """Write a record anew with another head, or other files."""
    record = Record(path)
    with target.open("wb") as stream:
        file = File(stream, "mdm/0.1.0")
        for name, facts in record.metadata.items():
            changed = head(facts) if name == "mdm" else facts
            file.metadata(name, {key: value for key, value in changed.items() if value is not None})
        for attached in record.attachments:
            file.attach(*attachment(attached))
        topics = {name: file.topic(*topic) for name, topic in record.topics.items()}
        for topic, time, sequence, data in record.raw():
            file.add_message(topics[topic], time, data, time, sequence)
        file.finish()
    return target


def test_a_model_that_is_not_the_runs_is_told_with_what_differs(mdm, folder):
    path = folder / "run.mcap"
    assert mdm("run", "tiger.toml", "--virtual", "--epochs", 3, "--record", path)[0] == 0
    assert mdm("replay", path)[0] == 0

    def worse(attached):
        return attached._replace(data=attached.data.replace(b"0.85 0.15", b"0.75 0.25"))

    other = rewritten(path, folder / "other.mcap", attachment=worse)
    told = (
        f"{other}: the model of ensemble 'tiger' is not that of the run (it differs in the model's "
        "observation function of action 'listen'): mdm "
    )
    assert_told(mdm("replay", other), told, "with --config a configuration of yours is compared")

    def policy(attached):
        return attached._replace(data=attached.data.replace(b"19.", b"18.")) if ".vf" in attached.name else attached

    other = rewritten(path, folder / "other.mcap", attachment=policy)
    told = "the policy of ensemble 'tiger' is not that of the run (it differs in the policy's vectors): mdm "
    assert_told(mdm("replay", other), told)
    assert mdm("replay", other, "--config", "tiger.toml")[0] == 0


@pytest.mark.parametrize("name", ["nothing", "../../../../up"])
def test_a_configuration_that_is_not_in_the_record_is_told(mdm, folder, name):
    path = folder / "run.mcap"
    assert mdm("run", "tiger.toml", "--virtual", "--epochs", 3, "--record", path)[0] == 0
    bad = rewritten(path, folder / "bad.mcap", head=lambda head: {**head, "configuration": name})
    assert_told(mdm("replay", bad), f"{bad}: ", name)


MAKERS = ["run tiger.toml --virtual --epochs 3 --record", "simulate tiger.toml --episodes 2 --record"]


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize(
    ("place", "sentence"),
    [
        ("nowhere/run.mcap", "the record cannot be written: its folder does not exist"),
        ("tiger.vf/run.mcap", "the record cannot be written: its folder does not exist"),
        (".", "this is a folder, not a file"),
        ("tiger.vf", "this file is not a record, and would be overwritten: name another one"),
        ("/proc/run.mcap", "the record cannot be written: "),
    ],
)
def test_a_record_that_cannot_be_written(mdm, folder, maker, place, sentence):
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert_told(mdm(*maker.split(), place), f"{place}: ", sentence)
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.mark.parametrize("maker", MAKERS)
def test_two_recorders_of_one_file(mdm, folder, maker):
    path = folder / "run.mcap"
    first = Writing(path)
    assert_told(mdm(*maker.split(), path), f"{path}: another program records to this file: give each a file of its own")
    first.write("controls", Control(1, "stop"))
    first.close()
    assert len(official(path)) == 1


@pytest.mark.parametrize("maker", MAKERS)
def test_a_record_that_is_there_is_kept(mdm, folder, maker):
    whole = written(folder / "run.mcap", [("decisions", decision(number)) for number in range(100)])
    torn = folder / "run.2.mcap"
    torn.write_bytes(whole.read_bytes()[:-50])
    before = {path: path.read_bytes() for path in (whole, torn)}
    status, _, errors = mdm(*maker.split(), whole)
    assert status == 0
    assert f"{torn} is kept as it is" in errors
    assert {path: path.read_bytes() for path in (whole, torn)} == before
    assert Record(folder / "run.3.mcap").closed


@pytest.mark.parametrize("target", ["nowhere/out", "tiger.vf/out", "/proc/out"])
@pytest.mark.parametrize(
    ("verb", "suffix"), [("record export", ".csv"), ("record repair", ".mcap"), ("plot run", ".png")]
)
def test_what_is_made_of_a_record_and_cannot_be_written(mdm, folder, verb, suffix, target):
    path = written(folder / "run.mcap", [("decisions", decision(1))])
    before = sorted(folder.iterdir())
    assert_told(mdm(*verb.split(), path, "-o", target + suffix), target)
    assert sorted(folder.iterdir()) == before


EXTRAS = [
    ("mcap", f"{MAKERS[0]} new.mcap", "records need mcap: pip install mcap threadpoolctl"),
    ("mcap", f"{MAKERS[1]} new.mcap", "records need mcap: pip install mcap threadpoolctl"),
    ("mcap", "record repair run.mcap -o OUT.mcap", "records need mcap: pip install mcap threadpoolctl"),
    ("zstandard", "record info run.mcap", "pip install mcap threadpoolctl"),
    ("zstandard", "replay run.mcap", "pip install mcap threadpoolctl"),
    ("pyarrow", "record export run.mcap -o OUT.parquet", "pip install pyarrow"),
    ("matplotlib", "plot run run.mcap -o OUT.png", "pip install matplotlib"),
]


@pytest.mark.parametrize(("extra", "command", "sentence"), EXTRAS)
def test_a_missing_extra(mdm, folder, monkeypatch, extra, command, sentence):
    written(folder / "run.mcap", [("decisions", decision(1))])
    gone = {extra, *({"compression.zstd", "backports.zstd"} if extra == "zstandard" else ())}
    for name in [*sys.modules]:
        if name.partition(".")[0] == extra:
            monkeypatch.delitem(sys.modules, name)
    for name in gone:
        monkeypatch.setitem(sys.modules, name, None)
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *rest: None if name in gone else find(name, *rest))
    before = sorted(folder.iterdir())
    assert_told(mdm(*command.split()), sentence)
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("command", "culprit"),
    [
        ("record", "VERB"),
        ("record info", "FILE"),
        ("record cat run.mcap --since soon", "soon"),
        ("record cat run.mcap --stimuli --topic decisions", "--topic"),
        ("record export run.mcap", "--output"),
        ("record export run.mcap -o run.txt", "run.txt"),
        ("record repair run.mcap", "--output"),
        ("replay run.mcap --most 0", "--most"),
        ("replay run.mcap --most few", "--most"),
    ],
)
def test_wrong_usage(mdm, folder, command, culprit):
    written(folder / "run.mcap", [("decisions", decision(1))])
    status, output, errors = mdm(*command.split())
    assert (status, output) == (2, [])
    assert culprit in errors.splitlines()[-1]


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        ("record cat run.mcap --topic lives", "there is no topic 'lives'; there are decisions"),
        ("record cat run.mcap --ensemble top", "there are no messages of 'top'; there are messages of patrol"),
        ("record cat run.mcap --stimuli", "there are no stimuli in this record"),
        ("record export run.mcap -o OUT.csv --ensemble top", "there are no decisions of 'top'; there are of patrol"),
        ("plot run run.mcap -o OUT.png --ensemble top", "there is no ensemble 'top'; there are patrol"),
        ("replay run.mcap --config nowhere.toml", "the record has no beginning"),
    ],
)
def test_what_a_record_does_not_have(mdm, folder, command, sentence):
    written(folder / "run.mcap", [("decisions", decision(1))])
    assert_told(mdm(*command.split()), "run.mcap: ", sentence)
    assert not [*folder.glob("OUT*")]


def test_another_configuration_that_does_not_load_is_told_with_its_problems(mdm, folder):
    path = folder / "run.mcap"
    assert mdm("run", "tiger.toml", "--virtual", "--epochs", 3, "--record", path)[0] == 0
    assert_told(mdm("replay", path, "--config", "nowhere.toml"), "nowhere.toml", "no such file")
    (folder / "other.toml").write_text("[ensembles.other]\npolicy = 'tiger.vf'\n")
    assert_told(mdm("replay", path, "--config", "other.toml"), "other.toml: ")
