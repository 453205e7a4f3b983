"""What a wrong value of a data sheet may have been mistaken for."""

import pytest

from bayesbl.identification.well_known_factors import guess_of

RATIO = 110.0


@pytest.mark.parametrize("off", [0.8, 1.0, 1.2])
@pytest.mark.parametrize(
    ("size", "words"),
    [
        (1e4, "kg cm²"),
        (1e3, "ms taken"),
        (RATIO**2, "ratio squared"),
        (RATIO, "the gear ratio:"),
        (57.2958, "degrees"),
        (9.5493, "rpm"),
    ],
)
def test_an_error_is_guessed_where_the_value_is_within_its_tolerance_without_it(
    size: float, words: str, off: float
) -> None:
    """Too large or too small."""
    for wrong in (size, 1.0 / size):
        believed = 2.0 * wrong
        assert words in guess_of(believed, 0.25 * believed, 2.0 * off, RATIO)


def test_nothing_is_guessed_elsewhere() -> None:
    assert guess_of(2.0, 0.5, 5.0, RATIO) == ""
    assert guess_of(2.0, 0.02, 2.0 * 1.1e4, RATIO) == ""


def test_the_nearest_error_comes_first() -> None:
    told = guess_of(1e4, 2.5e3, 1.02, RATIO)
    assert told.index("kg cm²") < told.index("ratio squared")
    assert "1/9800 of the data sheet's" in told


@pytest.mark.parametrize(("size", "words"), [(100.0, "cm taken"), (1e4, "kg cm²")])
def test_a_gear_ratio_that_is_a_unit_too_hides_no_guess(size: float, words: str) -> None:
    told = guess_of(2.0 * size, 0.5 * size, 2.0, gear_ratio=100.0)
    assert words in told
    assert "the gear ratio" in told
