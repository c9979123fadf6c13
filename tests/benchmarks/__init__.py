"""Speed and memory, measured: ``python -m tests.benchmarks`` (all) or ``… kernel table1`` (some).

Not tests: nothing here passes or fails. Every figure is printed beside what it is compared with in the same
run, with the machine, the versions and the input.
"""
