"""A small share of the fuzzer's cases; the rest runs by command, ``python -m tests.fuzz``."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz.cases import run_case


@pytest.mark.parametrize("first", [0, 10, 20, 30])
def test_mutated_files_run_or_are_refused_in_words_with_their_line(
    first: int, tmp_path: Path
) -> None:
    wrong = [run_case(seed, tmp_path) for seed in range(first, first + 10)]
    assert not [outcome for outcome in wrong if outcome.wrong]
