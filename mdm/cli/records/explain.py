"""``mdm explain``: why a decision in a record was made."""

from __future__ import annotations

import tempfile
from typing import TYPE_CHECKING

import msgspec

from mdm.cli.report import as_json
from mdm.cli.robots.why import named
from mdm.config.rebuilt import rebuilt
from mdm.config.recorded import different_entry, different_part
from mdm.errors import Error
from mdm.explanation import explain
from mdm.recording import Record
from mdm.replay.retraced import found, retraced

if TYPE_CHECKING:
    import argparse

    from mdm.actors import Ensemble

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Explain; return the exit status."""
    record = Record(arguments.file)
    place, decisions = found(record, arguments.ensemble, arguments.at)
    decision = decisions[place]
    with tempfile.TemporaryDirectory() as folder:
        ensemble = rebuilt(record, folder, arguments.config).ensembles.get(decision.ensemble)
        if ensemble is None:
            raise Error(
                f"{record.path}: the configuration has no ensemble {decision.ensemble!r}: a task has started it"
            )
        other = _difference(record, ensemble, given=arguments.config is not None)
        step = retraced(ensemble.controller, decisions, place, otherwise=other is not None)
        explanation = explain(named(ensemble, step.case(arguments.last or 10)))
    start = 0 if record.span is None else record.span[0]
    second = (decision.time - start) / 1e9
    if arguments.json:
        facts: dict[str, object] = {"ensemble": decision.ensemble, "time": second, "cause": decision.cause}
        facts |= msgspec.to_builtins(explanation)
        facts |= {} if other is None else {"configuration": other, "decided": decision.action_name}
        print(as_json(facts | {"flaws": record.flaws}))
    else:
        print(f"{decision.ensemble} at {second:.6g} s, because of: {decision.cause}.")
        if other is not None:
            print(f"By another configuration, as it would decide now ({other}); decided was {decision.action_name!r}.")
        print(explanation)
        for sentence in record.flaws:
            print(sentence)
    return 0


def _difference(record: Record, ensemble: Ensemble, *, given: bool) -> str | None:
    """Return what differs of the model, policy or options that decided, where they were given; None if nothing does.

    Raises:
        Error: If they are the record's own, which are read otherwise now.
    """
    path, controller = ensemble.path, ensemble.controller
    facts = record.metadata.get(f"ensemble {path}", {})
    known, now = facts.get("configuration"), controller.configuration
    if known is None or known == now:
        return None
    told = (different_entry(record, {path: ensemble}) if given else None) or different_part(facts, controller)
    digests = f"digest {now[:12]}, then {known[:12]}"
    if given:
        return told or digests
    raise Error(
        f"{record.path}: model, policy or options in the record, as mdm {record.head['mdm']} has read them, are not "
        f"those that decided in {path!r} ({digests if told is None else told}): what they say of its decisions would "
        f"explain nothing"
    )
