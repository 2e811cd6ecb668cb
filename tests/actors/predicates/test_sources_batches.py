"""Batches: one update each, of what their own task reports."""

from __future__ import annotations

import asyncio

import pytest

from mdm import PredicateManager
from mdm.testing import probe, run_virtual


def test_a_batch_is_one_update_and_glitch_free():
    async def main(runtime):
        manager = PredicateManager()
        a, b = manager.sensor("A", initial=True), manager.sensor("B", initial=False)
        manager.define("Both", "A and B")
        manager.define("None", "not A and not B")
        await runtime.start(manager)
        updates = probe(manager.updates)
        with manager.batch():
            a.set(False)
            with manager.batch():
                b.set(True)
            assert updates == []
        assert [(u.rising, u.falling) for u in updates] == [(("B",), ("A",))]
        with pytest.raises(LookupError), manager.batch():
            a.set(True)
            raise LookupError
        assert manager.value("Both") is True  # what the sensors said stays true

    run_virtual(main)


def test_a_batch_that_awaits_takes_its_own_tasks_changes_alone():
    async def main(runtime):
        manager = PredicateManager()
        first, second, third = (manager.sensor(name, initial=False) for name in "ABC")
        await runtime.start(manager)
        updates = probe(manager.updates)
        asyncio.get_running_loop().call_later(0.5, second.set, True)

        async def other():
            await asyncio.sleep(0.7)
            third.set(True)

        task = asyncio.create_task(other())
        with manager.batch():
            first.set(True)
            await asyncio.sleep(1.0)
            first.set(False)
            first.set(True)
        await task
        return [(update.time, update.rising) for update in updates]

    assert run_virtual(main)[-3:] == [(500_000_000, ("B",)), (700_000_000, ("C",)), (1_000_000_000, ("A",))]
