"""``python -m tests.benchmarks [NAME …]``."""

import argparse

from tests.benchmarks import codecs, fdm, growth, kernel, orca, orient, resin_12k, slicing, startup, surface, table1
from tests.benchmarks.measuring import machine

BENCHMARKS = {
    "kernel": kernel.run,
    "table1": table1.run,
    "resin": resin_12k.run,
    "codecs": codecs.run,
    "growth": growth.run,
    "fdm": fdm.run,
    "orient": orient.run,
    "startup": startup.run,
    "orca": orca.run,
    "surface": surface.run,
    "slicing": slicing.run,
}

parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
parser.add_argument(
    "names", nargs="*", choices=[[], *BENCHMARKS], default=[], metavar="NAME", help=", ".join(BENCHMARKS)
)
chosen = parser.parse_args().names or list(BENCHMARKS)
print(machine())
for name in chosen:
    print(f"\n## {name}\n")
    BENCHMARKS[name]()
