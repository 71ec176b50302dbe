"""
Mutation testing: change the code in one place at a time, and see whether a test fails.

`make mutation` runs this, with names of mutants (patterns) as optional arguments. It copies the
project to build/mutation, lets mutmut make and test the mutants there, prints those that no test
detects, and fails if they are too many. Some mutants change nothing that a user could notice. The
modules and tests are listed in pyproject.toml, [tool.mutmut].
"""

from itertools import accumulate
import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

ROOT = Path(__file__).resolve().parent.parent
WORK = ROOT / 'build' / 'mutation'
COPIED = ('inverse_dynamics_node', 'test', 'config', 'pyproject.toml')
LEAST_SCORE = 91.0  # [%] of all mutants; 94 % were detected when the limit was chosen
TEST_TIME = 8.0  # [s] of tests for each mutant, the quick ones first: slower ones rarely find more
SURVIVED, NO_TESTS = 0, 33  # codes of mutmut; others are a failed test or a time-out


def copy_project():
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, WORK / name, ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy2(ROOT / name, WORK / name)
    # mutmut leaves decorated functions alone. This decorator does nothing without compilation.
    replace(WORK / 'inverse_dynamics_node', r'^@compiled\n', '')
    # Every surviving mutant runs all of these.
    replace(WORK / 'test' / 'property', r'max_examples=\d+', 'max_examples=20')


def replace(folder, pattern, by):
    for path in folder.rglob('*.py'):
        before = path.read_text()
        after = re.sub(pattern, by, before, flags=re.MULTILINE)
        if after != before:
            path.write_text(after)


def drop_call(statement):
    """Mutate a statement that is only a call: leave it out."""
    import libcst

    if isinstance(statement.value, libcst.Call):
        yield statement.with_changes(value=libcst.Name('None'))


def run_mutmut(arguments):
    """Run mutmut in this process, which forks once for each mutant."""
    import libcst
    from mutmut.__main__ import cli
    from mutmut.mutation import mutators
    from mutmut.runners.harness import PytestRunner
    from mutmut.state import state

    operators = mutators.mutation_operators
    # Most texts are messages. A test of every word would only get in the way.
    operators.remove((libcst.BaseString, mutators.operator_string))
    operators.append((libcst.Expr, drop_call))

    arguments_of = PytestRunner._pytest_args_regular_run

    def quick_ones_first(self, tests):
        durations = {test: state().duration_by_test.get(test, 0.0) for test in tests}
        ordered = sorted(tests, key=durations.__getitem__)
        totals = accumulate(durations[test] for test in ordered)
        kept = [test for test, total in zip(ordered, totals, strict=True) if total <= TEST_TIME]
        return arguments_of(self, kept or ordered)

    PytestRunner._pytest_args_regular_run = quick_ones_first
    cli(['run', *arguments], standalone_mode=False)


def results():
    """Return how many mutants were tested, and the survivors as lines of a diff."""
    from mutmut.mutation.diff_apply import get_diff_for_mutant

    number, survivors = 0, []
    for path in sorted(Path('mutants').rglob('*.meta')):
        source = path.relative_to('mutants').with_suffix('')
        codes = json.loads(path.read_text())['exit_code_by_key']
        for name, code in codes.items():
            number += code is not None
            if code in (SURVIVED, NO_TESTS):
                diff = get_diff_for_mutant(name, path=source).splitlines()[2:]
                changed = [f'{line[0]} {line[1:].strip()}' for line in diff if line[0] in '+-']
                survivors.append('\n'.join([f'@@ {function_of(name)}', *changed]))
    return number, survivors


def function_of(mutant):
    """Return module, class and function, such as 'loads.Loads._fade'."""
    module, _, name = mutant.rpartition('.')
    name = re.sub(r'__mutmut_\d+$', '', name)
    name = name.replace('ǁ', '.').removeprefix('x.') if 'ǁ' in name else name.removeprefix('x_')
    return f'{module.rpartition(".")[2]}.{name}'


def report():
    number, survivors = results()
    print('\n'.join(survivors))
    score = 100.0 * (number - len(survivors)) / max(number, 1)
    print(
        f'{number} mutants, {len(survivors)} of them survived. Score {score:.1f} %, '
        f'expected at least {LEAST_SCORE:g} %'
    )
    return score >= LEAST_SCORE


def main(arguments):
    if Path.cwd() == WORK:
        run_mutmut(arguments)
        return 0 if report() else 1
    copy_project()
    # Compiled code takes no notice of mutants, and takes time to make.
    environment = {**os.environ, 'NUMBA_DISABLE_JIT': '1'}
    return subprocess.run(
        [sys.executable, __file__, *arguments], cwd=WORK, env=environment
    ).returncode


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
