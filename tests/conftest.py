"""Shared settings of the tests: hypothesis profiles, signals, and files of other projects, where they are."""

from __future__ import annotations

import gc
import os
import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING

import kernels
import processor_time
import pytest
import sentences
from hypothesis import HealthCheck, settings
from imported import forgetting
from places import CORPUS
from values import ValuesPlugin

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported: workers would fight for the cores

settings.register_profile("default", deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("thorough", parent=settings.get_profile("default"), max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the limit on what a test takes."""
    parser.addoption("--processor-limit", type=float, metavar="SECONDS", help="fail a test that takes more")


def pytest_configure(config: pytest.Config) -> None:
    """Set the limit on what a test takes, where one is given; note the values of options; and repair signals."""
    config.pluginmanager.register(ValuesPlugin(config))
    if (seconds := config.getoption("--processor-limit")) is not None:
        config.pluginmanager.register(processor_time.Limit(seconds))
    _repair_signals()


def _repair_signals() -> None:
    """Give signals their meaning back: a background shell ignores SIGINT, nohup SIGHUP, and children inherit that.

    Programs that tests start get the default: a handler is not inherited. A hang-up still does not end the suite.
    """
    for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, lambda *_: None)):
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Collect tests without a garbage collector: it would search all modules again and again, and find next to nothing.

    What was made by then stays until the end, and is not searched later either, not even as the interpreter ends.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Compare the sentences of errors that a test is told."""
    with sentences.of(item.nodeid):
        yield


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the sentences of errors anew, where that is asked for."""
    if sentences.WRITING in os.environ and hasattr(session, "items"):
        sentences.write_all(item.nodeid for item in session.items)


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop(session: pytest.Session) -> Iterator[object]:
    """Compile kernels before the first test; run tests with plain ones, but those that need what is compiled."""
    if not session.config.option.collectonly:
        kernels.compile_for(session.items)
    with kernels.as_plain_python():
        return (yield)


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep what processes of a user share in a folder of the tests."""
    os.environ["MDM_CACHE"] = str(tmp_path_factory.mktemp("cache"))


@contextmanager
def _same_signals() -> Iterator[None]:
    """See that a test leaves signals to whom it found them with: a later one would wait for ever for its Ctrl-C."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(number) for number in numbers]
    yield
    assert [signal.getsignal(number) for number in numbers] == before


@pytest.fixture(autouse=True, scope="module")
def _file_apart(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep a file of tests from the next one, and the garbage collector from what outlives a file: modules, and tests.

    They are some hundred megabytes, which it searched at every collection: a quarter of the time of tests that allocate
    much. What a test makes is collected as ever.
    """
    gc.collect()
    gc.freeze()
    with forgetting(tmp_path_factory.getbasetemp()):
        yield


@pytest.fixture(autouse=True)
def _test_apart(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep a test from the next one; in one fixture, for each takes a tenth of a millisecond in each of 9,000 tests."""
    with _same_signals(), forgetting(tmp_path_factory.getbasetemp()), kernels.needed_by(request.node):
        yield


@pytest.fixture(scope="module")
def recorded_here() -> Iterator[None]:
    """Have records written by threads of this process: to start a Python for each takes longer than most tests."""
    from recorded_here import recorded_by_threads

    with recorded_by_threads():
        yield


@pytest.fixture
def corpus(request: pytest.FixtureRequest) -> Path:
    """The folder of public files that may stand beside a checkout; `foreign` marks which of them a test needs."""
    (needed,) = request.node.get_closest_marker("foreign").args
    if not CORPUS.is_dir():
        pytest.skip(f"needs {needed}; not part of this repository")
    return CORPUS
