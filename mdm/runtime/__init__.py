"""The runtime: actors, channels, turns, clocks, supervision. It knows nothing of Markov models."""

from mdm.runtime.actor import Actor
from mdm.runtime.channel import Channel, Overflow, Stream, Subscription
from mdm.runtime.dispatcher import Dispatcher
from mdm.runtime.extension import Extension
from mdm.runtime.observing import Observer
from mdm.runtime.process.log import Log
from mdm.runtime.process.runner import run
from mdm.runtime.runtime import Runtime, RuntimeStatistics
from mdm.runtime.statistics import (
    ActorStatistics,
    ChannelStatistics,
    DispatcherStatistics,
    Histogram,
    Latencies,
    LogStatistics,
    LoopStatistics,
)
from mdm.runtime.supervision import ActorFailure, Restart, Supervision
from mdm.runtime.time.clock import Clock, Timer, WallClock
from mdm.runtime.time.scheduler import Ticker
from mdm.runtime.time.virtual import DeadlockError, VirtualClock, VirtualEventLoop
from mdm.runtime.work import Work

__all__ = [
    "Actor",
    "ActorFailure",
    "ActorStatistics",
    "Channel",
    "ChannelStatistics",
    "Clock",
    "DeadlockError",
    "Dispatcher",
    "DispatcherStatistics",
    "Extension",
    "Histogram",
    "Latencies",
    "Log",
    "LogStatistics",
    "LoopStatistics",
    "Observer",
    "Overflow",
    "Restart",
    "Runtime",
    "RuntimeStatistics",
    "Stream",
    "Subscription",
    "Supervision",
    "Ticker",
    "Timer",
    "VirtualClock",
    "VirtualEventLoop",
    "WallClock",
    "Work",
    "run",
]
