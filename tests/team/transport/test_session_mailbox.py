from __future__ import annotations

import asyncio
import threading
import time

import pytest
from hypothesis import given, strategies as st
from patience import PATIENCE

from mdm.team.transport.session import Mailbox


@pytest.fixture(scope="module", autouse=True, params=["eventfd", "call"])
def loop_with_and_without_readers(request):
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "call":

            def refuse(*_):
                raise NotImplementedError

            patch.setattr(asyncio.SelectorEventLoop, "add_reader", refuse)
        yield


class Receiver:
    """What a mailbox hands on."""

    def __init__(self, **options):
        self.got, self.lost, self.failures = [], {}, []
        self.mailbox = Mailbox(
            asyncio.get_running_loop(),
            lambda key, data, now, carrier: self.got.append((key, data)),
            lambda key, count: self.lost.update({key: self.lost.get(key, 0) + count}),
            now=int,
            urgent=lambda data: data.startswith(b"step"),
            failed=self.failures.append,
            **options,
        )

    async def until(self, condition):
        async with asyncio.timeout(PATIENCE):
            while not condition():
                await asyncio.sleep(0)


def test_what_threads_put_comes_in_their_order():
    async def main():
        receiver = Receiver(bound=100_000)

        def put(name):
            for number in range(5000):
                receiver.mailbox.put("c", name, b"%d" % number)

        threads = [threading.Thread(target=put, args=(name,)) for name in "ab"]
        for thread in threads:
            thread.start()
        await receiver.until(lambda: len(receiver.got) == 10_000)
        for name in "ab":
            assert [data for key, data in receiver.got if key == name] == [b"%d" % number for number in range(5000)]
        for thread in threads:
            thread.join()
        receiver.mailbox.close()
        assert receiver.lost == {}

    asyncio.run(main())


def test_a_thread_wakes_the_loop_once_for_many():
    async def main():
        receiver = Receiver()
        arms = []
        arm = receiver.mailbox._arm
        receiver.mailbox._arm = lambda: (arms.append(1), arm())
        for _ in range(100):
            receiver.mailbox.put("c", "k", b"")
        await receiver.until(lambda: len(receiver.got) == 100)
        assert len(arms) == 1
        receiver.mailbox.close()

    asyncio.run(main())


def test_a_crowd_wakes_nobody_and_is_handed_on_all_the_same():
    async def main():
        receiver = Receiver(bound=1_000_000)
        ended = threading.Event()

        def put():
            for number in range(100_000):
                receiver.mailbox.put("c", "k", b"%d" % number)
            ended.set()

        thread = threading.Thread(target=put)
        thread.start()
        await receiver.until(lambda: len(receiver.got) == 100_000)
        thread.join()
        assert [int(data) for _, data in receiver.got] == list(range(100_000))
        for _ in range(3):  # and back to one at a time
            count = len(receiver.got)
            receiver.mailbox.put("c", "k", b"")
            await receiver.until(lambda count=count: len(receiver.got) > count)
        receiver.mailbox.close()

    asyncio.run(main())


def test_a_slow_handler_lets_the_loop_breathe():
    async def main():
        receiver = Receiver()
        receiver.mailbox._deliver = lambda *_: (receiver.got.append(1), time.sleep(0.001))
        for _ in range(300):
            receiver.mailbox.put("c", "k", b"")
        turns = 0
        while len(receiver.got) < 300:
            await asyncio.sleep(0)
            turns += 1
        assert turns > 3
        receiver.mailbox.close()

    asyncio.run(main())


def test_beyond_the_bound_the_newest_of_each_key_stays_and_steps_before_values():
    async def main():
        receiver = Receiver(bound=100)
        put = receiver.mailbox.put
        for number in range(40):
            put("c", "step", b"step%d" % number)
        for number in range(1000):
            put("c", f"k{number % 3}", b"%d" % number)
        await receiver.until(lambda: not receiver.mailbox.items)
        assert [data for key, data in receiver.got if key == "step"] == [b"step%d" % number for number in range(40)]
        for one in range(3):
            numbers = [int(data) for key, data in receiver.got if key == f"k{one}"]
            assert numbers == sorted(numbers)
            assert numbers[-1] == max(number for number in range(1000) if number % 3 == one)
        assert sum(receiver.lost.values()) == 1040 - len(receiver.got)
        receiver.mailbox.close()

    asyncio.run(main())


def test_of_too_many_keys_the_oldest_values_go():
    async def main():
        receiver = Receiver(bound=100)
        receiver.mailbox.put("c", "step", b"step")
        for number in range(1000):
            receiver.mailbox.put("c", f"k{number}", b"")
        await receiver.until(lambda: not receiver.mailbox.items)
        keys = [key for key, _ in receiver.got]
        assert keys[0] == "step"
        assert keys[1:] == [f"k{number}" for number in range(1000 - len(keys) + 1, 1000)]
        receiver.mailbox.close()

    asyncio.run(main())


def test_steps_alone_are_bounded_too_and_the_newest_stay():
    async def main():
        receiver = Receiver(bound=100)
        for number in range(1000):
            receiver.mailbox.put("c", "step", b"step%d" % number)
        await receiver.until(lambda: not receiver.mailbox.items)
        numbers = [int(data[4:]) for _, data in receiver.got]
        assert numbers == list(range(1000 - len(numbers), 1000))
        assert 50 <= len(numbers) <= 100
        receiver.mailbox.close()

    asyncio.run(main())


def test_large_messages_are_bounded_by_their_bytes():
    async def main():
        receiver = Receiver()
        body = bytes(8 << 20)
        for number in range(20):
            receiver.mailbox.put("c", f"k{number}", body)
            assert len(receiver.mailbox.items) * len(body) <= 64 << 20
        await receiver.until(lambda: not receiver.mailbox.items)
        assert receiver.got[-1][0] == "k19"
        assert len(receiver.got) + len(receiver.lost) == 20
        for number in range(20):  # what was taken counts no more
            receiver.mailbox.put("c", f"k{number}", body[: 1 << 20])
        await receiver.until(lambda: not receiver.mailbox.items)
        assert len(receiver.got) + len(receiver.lost) == 40
        receiver.mailbox.close()

    asyncio.run(main())


@given(
    bound=st.integers(4, 20),
    messages=st.lists(st.tuples(st.sampled_from("abcdef"), st.sampled_from([b"step", b""])), max_size=60),
)
def test_whatever_comes_is_handed_on_or_counted(bound, messages):
    async def main():
        receiver = Receiver(bound=bound)
        for number, (key, priority) in enumerate(messages):
            receiver.mailbox.put("c", key, b"%s%d" % (priority, number))
            assert len(receiver.mailbox.items) <= bound
        await receiver.until(lambda: not receiver.mailbox.items and not receiver.mailbox.armed)
        numbers = [int(data.removeprefix(b"step")) for _, data in receiver.got]
        assert numbers == sorted(numbers)
        assert len(numbers) + sum(receiver.lost.values()) == len(messages)
        steps = [number for number, (_, priority) in enumerate(messages) if priority]
        assert set(steps[-1:]) <= set(numbers)
        if messages and not steps:
            assert numbers[-1] == len(messages) - 1
        receiver.mailbox.close()

    asyncio.run(main())


def test_calls_run_in_their_place_and_what_they_raise_is_told():
    async def main():
        receiver = Receiver(bound=10)
        error = ValueError("no")

        def fail():
            raise error

        receiver.mailbox.put("c", "first", b"")
        receiver.mailbox.post(lambda: receiver.got.append("call"))
        receiver.mailbox.post(fail)
        for _ in range(20):
            receiver.mailbox.put("c", "second", b"")
        await receiver.until(lambda: not receiver.mailbox.items)
        assert receiver.got[:2] == [("first", b""), "call"]
        assert receiver.failures == [error]
        receiver.mailbox.close()

    asyncio.run(main())


def test_once_closed_nothing_comes_and_nothing_is_written():
    async def main():
        receiver = Receiver()
        receiver.mailbox.put("c", "k", b"")
        receiver.mailbox.close()
        receiver.mailbox.close()
        receiver.mailbox.put("c", "k", b"")
        receiver.mailbox.post(lambda: receiver.got.append("call"))
        await asyncio.sleep(0.01)
        assert receiver.got == []
        return receiver

    receiver = asyncio.run(main())
    receiver.mailbox.put("c", "k", b"")  # the loop is closed


def test_a_handler_that_closes_the_mailbox_is_the_last():
    async def main():
        receiver = Receiver()
        receiver.mailbox._deliver = lambda *_: (receiver.got.append(1), receiver.mailbox.close())
        receiver.mailbox.put("c", "k", b"")
        receiver.mailbox.put("c", "k", b"")
        await receiver.until(lambda: receiver.got)
        await asyncio.sleep(0)
        assert receiver.got == [1]

    asyncio.run(main())


def test_questions_are_bounded_too_and_those_too_many_are_counted():
    async def main():
        receiver = Receiver(bound=8)
        answered = []
        assert [receiver.mailbox.offer("k", lambda: answered.append(1)) for _ in range(10)] == [True] * 8 + [False] * 2
        await receiver.until(lambda: receiver.lost == {"k": 2} and len(answered) == 8)
        receiver.mailbox.close()

    asyncio.run(main())
