"""A node of ROS that does what it is told by lines of JSON, and prints what it hears; by rclpy itself.

Its argument is JSON: the node's name. A line has one of these commands, and what belongs to it:

- ``{"publish": topic, "type": …, "message": {…}, "rate": 10}``: a message ten times a second from then on; without a
  rate once; with rate 0 no more. ``"turns": [{…}, {…}]`` are several by turns. ``"latched": true`` keeps the last
  message for who comes later. ``"reliable": false`` is best effort. The topic is there from the first such line on;
  ``"quiet": true`` makes it and publishes nothing.
- ``{"flood": topic, "messages": [{…}], "count": 9000, "rate": 9000}``: these by turns. A field that is
  ``{"value": 0.5, "times": 1000}`` is a long array.
- ``{"echo": topic, "type": …}`` prints each message as ``{"heard": topic, "message": {…}}``.
- ``{"serve": service, "type": …, "response": {…}, "silent": false}`` prints each request, and answers unless silent.
- ``{"act": action, "type": …, "answer": true, "on_cancel": true, "brake": 0.0}``: an action's server. Each goal is
  ``{"goal": number, "fields": {…}}``; ``answer`` says whether it is accepted; null: once ``{"answer": true}`` comes.
  A request to cancel prints ``{"cancel": number}``; the goal ends after ``brake`` seconds, or by ``finish`` where that
  is null, or by success where it is "reach". ``"replaces": true`` aborts a goal where another comes. ``{"accepted":
  number, "live": 1}`` tells how many are live. ``"beat": 10`` gives feedback ten times a second. ``{"options": {…}}``
  changes answers and ends.
- ``{"feedback": {…}}`` and ``{"finish": 4, "result": {…}}`` are of the newest goal, or of ``"of": number``.
- ``{"remove": name}`` takes a publisher, subscription, service or action away; ``{"call": service, "type": …}`` calls;
  ``{"graph": true}`` prints nodes and topics; ``{"matched": topic}`` prints that it has its counterpart, once it has;
  ``{"live": true}`` prints how many goals are live; ``{"echoed": 1}`` is printed back.
"""

import array
import itertools
import json
import sys
import threading
import time
from importlib import import_module
from operator import attrgetter

import numpy as np
import rclpy
from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

LOCK = threading.Lock()


def tell(**what):
    with LOCK:
        sys.stdout.write(json.dumps(what) + "\n")
        sys.stdout.flush()


def kind(name):
    package, folder, last = name.split("/")
    return attrgetter(last)(import_module(f"{package}.{folder}"))


def plain(value):
    """Return a message as what JSON has."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):  # one byte
        return value[0]
    if isinstance(value, (list, tuple, array.array, np.ndarray)):
        return [plain(each) for each in value]
    return value.item() if isinstance(value, np.generic) else value


def filled(message, fields):
    """Set fields of a message by name; others keep what they have."""
    types = message.get_fields_and_field_types()
    for name, value in fields.items():
        if isinstance(value, dict) and "times" in value:
            setattr(message, name, array.array(getattr(message, name).typecode, [value["value"]]) * value["times"])
        elif isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            element = types[name].removeprefix("sequence<").partition("[")[0].partition(",")[0].rstrip(">")
            package, _, last = element.partition("/")
            setattr(message, name, [filled(kind(f"{package}/msg/{last}")(), each) for each in value])
        elif types[name] in ("octet", "byte"):
            setattr(message, name, bytes([value]))
        else:
            setattr(message, name, value)
    return message


class Served:
    """An action's server, whose goals end as they are told."""

    def __init__(self, peer, act, type, answer=True, on_cancel=True, brake=0.0, replaces=False, beat=0.0, **_):  # noqa: A002
        self.peer, self.kind, self.count, self.live = peer, kind(type), 0, {}
        self.options = {"answer": answer, "on_cancel": on_cancel, "brake": brake, "replaces": replaces}
        self.asked = []
        if beat:
            self.peer.node.create_timer(1 / beat, self.beat)
        self.numbers = {}
        self.server = ActionServer(
            *(peer.node, self.kind, act, self.pursue),
            goal_callback=self.answer,
            cancel_callback=self.cancel,
            handle_accepted_callback=self.accepted,
            callback_group=ReentrantCallbackGroup(),
            result_timeout=3600,
        )

    async def answer(self, goal):
        self.count += 1
        self.numbers[id(goal)] = self.count
        tell(goal=self.count, fields=plain(goal))
        answer = self.options["answer"]
        if answer is None:
            asked = Future()
            self.asked.append(asked)
            answer = await asked
        return GoalResponse.ACCEPT if answer else GoalResponse.REJECT

    def accepted(self, handle):
        number = self.numbers.pop(id(handle.request), self.count)
        if self.options["replaces"]:
            for other in self.live.values():
                self.end(other, GoalStatus.STATUS_ABORTED)
        handle.number, handle.end, handle.status_set = number, Future(), False
        self.live[number] = handle
        tell(accepted=number, live=len(self.live))
        handle.execute()

    def cancel(self, handle):
        tell(cancel=handle.number)
        if not self.options["on_cancel"]:
            return CancelResponse.REJECT
        if (brake := self.options["brake"]) == "reach":
            self.end(handle, GoalStatus.STATUS_SUCCEEDED)
        elif brake is not None:
            self.peer.later(brake, lambda: self.end(handle, GoalStatus.STATUS_CANCELED))
        return CancelResponse.ACCEPT

    def end(self, handle, status, result=None):
        if not handle.end.done():
            handle.end.set_result((status, result or {}))
            self.peer.executor.wake()

    async def pursue(self, handle):
        status, result = await handle.end
        del self.live[handle.number]
        if status == GoalStatus.STATUS_CANCELED and not handle.is_cancel_requested:
            status = GoalStatus.STATUS_ABORTED
        {4: handle.succeed, 5: handle.canceled, 6: handle.abort}[status]()
        tell(ended=handle.number, status=status)
        return filled(self.kind.Result(), result)

    def beat(self):
        for handle in self.live.values():
            handle.publish_feedback(self.kind.Feedback())

    def of(self, command):
        return self.live.get(command.get("of", max(self.live, default=None)))

    def finish(self, command):
        if (handle := self.of(command)) is not None:
            self.end(handle, command["finish"], command.get("result"))

    def feedback(self, command):
        if (handle := self.of(command)) is not None:
            handle.publish_feedback(filled(self.kind.Feedback(), command["feedback"]))


class Peer:
    def __init__(self, node, executor):
        self.node, self.executor = node, executor
        self.publishers, self.timers, self.things, self.action = {}, {}, {}, None

    def later(self, seconds, call):
        """Call once, after so many seconds; at once where they are 0."""
        if not seconds:
            self.executor.create_task(call)
            return

        def once():
            self.node.destroy_timer(timer)
            call()

        timer = self.node.create_timer(seconds, once)

    def publish(self, publish, type, *, rate=None, quiet=False, message=None, turns=(), **quality):  # noqa: A002
        if publish not in self.publishers:
            self.publishers[publish] = self.node.create_publisher(kind(type), publish, self.quality(**quality))
        publisher = self.publishers[publish]
        if (timer := self.timers.pop(publish, None)) is not None:
            self.node.destroy_timer(timer)
        if quiet or rate == 0:
            return
        ready = itertools.cycle([filled(kind(type)(), each) for each in turns or [message or {}]])
        publisher.publish(next(ready))
        if rate:
            self.timers[publish] = self.node.create_timer(1 / rate, lambda: publisher.publish(next(ready)))

    def quality(self, *, depth=10, reliable=True, latched=False):
        return QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )

    def flood(self, flood, messages, count, rate):
        """Publish these messages by turns, so many, so many a second; then say after how many seconds."""
        publisher = self.publishers[flood]
        ready = [filled(publisher.msg_type(), each) for each in messages]

        def run():
            begin = time.monotonic()
            for number in range(count):
                while time.monotonic() < begin + number / rate:
                    time.sleep(0.0005)
                publisher.publish(ready[number % len(ready)])
            tell(flooded=count, seconds=time.monotonic() - begin)

        threading.Thread(target=run).start()

    def echo(self, echo, type, reliable=True):  # noqa: A002
        quality = self.quality(depth=1000, reliable=reliable)
        hear = lambda message: tell(heard=echo, message=plain(message))
        self.things[echo] = self.node.create_subscription(kind(type), echo, hear, quality)

    def serve(self, serve, type, response=None, silent=False):  # noqa: A002
        async def answer(request, ready):
            tell(request=serve, fields=plain(request))
            if silent:
                await Future()
            return filled(ready, response or {})

        group = ReentrantCallbackGroup()
        self.things[serve] = self.node.create_service(kind(type), serve, answer, callback_group=group)

    def call(self, call, type, request=None):  # noqa: A002
        client = self.things.setdefault(f"client of {call}", self.node.create_client(kind(type), call))

        def ask():
            if not client.service_is_ready():
                self.later(0.02, ask)
                return
            future = client.call_async(filled(kind(type).Request(), request or {}))
            future.add_done_callback(lambda done: tell(response=call, fields=plain(done.result())))

        ask()

    def cancel_all(self, cancel_all):
        """Cancel all goals of an action's server, whoever sent them."""
        client = self.node.create_client(CancelGoal, f"{cancel_all}/_action/cancel_goal")

        def ask():
            if client.service_is_ready():
                client.call_async(CancelGoal.Request())
            else:
                self.later(0.02, ask)

        ask()

    def remove(self, remove):
        if remove in self.publishers:
            if (timer := self.timers.pop(remove, None)) is not None:
                self.node.destroy_timer(timer)
            self.node.destroy_publisher(self.publishers.pop(remove))
        elif (thing := self.things.pop(remove, None)) is None:
            self.action.server.destroy()
        elif not self.node.destroy_subscription(thing):
            self.node.destroy_service(thing)
        tell(removed=remove)

    def graph(self, graph):
        node = self.node
        tell(nodes=node.get_node_names(), topics=dict(node.get_topic_names_and_types()))

    def matched(self, matched, type="test_msgs/msg/Empty"):  # noqa: A002
        """Print that a topic's publisher, an echo or an action's server has its counterpart, once it has."""

        def look():
            if (
                self.publishers[matched].get_subscription_count()
                if matched in self.publishers
                else self.node.count_clients(matched)
                if matched.endswith("/_action/send_goal")
                else self.node.count_publishers(matched)
            ):
                tell(matched=matched)
            else:
                self.later(0.02, look)

        look()

    def obey(self, command):
        for name in ("publish", "flood", "echo", "serve", "call", "remove", "graph", "matched"):
            if name in command:
                getattr(self, name)(**command)
        if "act" in command:
            self.action = Served(self, **command)
        if "options" in command:
            self.action.options.update(command["options"])
        if "answer" in command and "act" not in command:
            while self.action.asked:
                self.action.asked.pop().set_result(command["answer"])
            self.executor.wake()  # a coroutine that waits for a future goes on where its executor spins
        if "feedback" in command:
            self.action.feedback(command)
        if "finish" in command:
            self.action.finish(command)
        if "cancel_all" in command:
            self.cancel_all(**command)
        if "live" in command:
            tell(lives=len(self.action.live))
        if "echoed" in command:
            tell(echoed=command["echoed"])


def main():
    context = Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(json.loads(sys.argv[1])["name"], context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    peer = Peer(node, executor)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    tell(spins=True)
    for line in sys.stdin:
        executor.create_task(peer.obey, json.loads(line))
    executor.shutdown()
    thread.join()
    rclpy.shutdown(context=context)


main()
