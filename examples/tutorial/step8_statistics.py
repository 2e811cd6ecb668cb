"""Step 8, statistics: the record of a run tells that a number of its model is wrong, and what to put in its place."""

import shutil
import sys
import tempfile
from pathlib import Path

from floor import PATROL

import mdm
from mdm import estimation

sys.path.insert(0, str(PATROL))
from make_models import top  # which stands beside the demo

hopeful = top(goes_out=0.75)  # three of four fires go out by themselves within a step, it says
policy = mdm.solve(hopeful).policy


def record(folder: Path) -> Path:
    """Run the demo for ten minutes with this model at its top level; return the record."""
    shutil.copytree(PATROL, folder)
    mdm.save_model(hopeful, folder / "top.pomdpx")
    mdm.save_policy(policy, folder / "top.policy", hopeful)

    async def main() -> None:
        async with mdm.Runtime(record=folder / "run.mcap", log=None) as runtime:
            await runtime.start(mdm.load_system(folder / "patrol.toml"))
            await runtime.clock.sleep(600)

    mdm.run(main, virtual=True)
    return folder / "run.mcap"


with tempfile.TemporaryDirectory() as folder:
    records = estimation.open_records([record(Path(folder) / "patrol")])
    chains = estimation.chains_of_records(records, "top")

report = estimation.statistics(chains, hopeful, step=1.0)  # rewards are those of a second
print(f"{report.count('differs')} rows differ from the model, {report.count('agrees')} agree")
for row in report.rows:
    if row.says == "differs":
        out = [entry for entry in row.entries if entry.symbol.endswith("no")]  # person, intruder, fire
        chance, times = sum(entry.model or 0 for entry in out), sum(entry.count for entry in out)
        print(f"{row.action} in {row.state!r}: the fire is out with {chance:.2f}; {times:g} of {row.visits:g} times")

better = mdm.solve(report.model, durations=report.durations).policy
for name, each in (("old", policy), ("new", better)):
    worth = mdm.evaluate(report.model, each, durations=report.durations, seed=1).mean
    print(f"the {name} policy is worth {worth:.0f}")
