"""The benchmark of DAIML times what it says it times."""

import pytest

from benchmarks import daiml


@pytest.mark.slow
def test_an_epoch_is_timed_without_its_compilation() -> None:
    row = daiml.neural_fly_epoch(epochs=20)
    assert 0 < row["ms"] <= row["ms_median"]
    assert 1e-3 * 20 * row["ms"] < row["first_chunk_s"]


@pytest.mark.slow
def test_more_conditions_take_more_memory() -> None:
    few, many = daiml.more_conditions(6), daiml.more_conditions(60)
    assert many["data_mb"] == pytest.approx(10 * few["data_mb"], rel=0.1)
    assert few["peak_mb"] * 2**20 > few["data_mb"]
