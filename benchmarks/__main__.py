"""Run all benchmarks, then print and write doc/evidence/benchmarks.md: `make bench`."""

from __future__ import annotations

import argparse
from pathlib import Path
from time import perf_counter
import warnings

from robot_files import ROOT

from . import machine, report, startup, tables
from .robots import robots

QUICK = 5  # rounds if only checking that the benchmarks run
ROUNDS = 60
QUANTITY_ROUNDS = 30
BATCH_ROUNDS = 40


def main() -> None:
    """Run all benchmarks, then print and write the page."""
    parser = argparse.ArgumentParser(prog='make bench', description=__doc__)
    parser.add_argument('--quick', action='store_true', help='few rounds; writes no page')
    folder = ROOT / 'doc' / 'evidence'
    parser.add_argument('--doc', type=Path, default=folder, help='folder of the page')
    arguments = parser.parse_args()
    warnings.simplefilter('ignore')  # the libraries warn about some robots
    quick = arguments.quick
    start = perf_counter()

    def rounds(usual: int) -> int:
        return min(usual, QUICK) if quick else usual

    def done(what: str) -> None:
        print(f'{perf_counter() - start:4.0f} s: {what}', flush=True)

    found = robots()
    done('robots read')
    results = report.Results()
    results.machine = machine.describe()
    results.calls = tables.calls(found, rounds(ROUNDS))
    done('one call')
    results.quantities = tables.quantities_of_one_call(found, rounds(QUANTITY_ROUNDS))
    done('every quantity, one call')
    # A loop over Pinocchio's calls takes seconds for the longest chain.
    results.quantity_batches = tables.quantities_of_batches(
        found[:-1], rounds(QUANTITY_ROUNDS // 2)
    )
    done('every quantity, batches')
    results.batches = tables.batches(found, rounds(BATCH_ROUNDS))
    done('batches')
    results.startup = startup.best(*((1, 1) if quick else (7, 3)))
    done('start-up')
    page = report.page(results)
    print('\n' + page)
    if not quick:
        (arguments.doc / 'benchmarks.md').write_text(page)


if __name__ == '__main__':
    main()
