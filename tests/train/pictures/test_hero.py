"""The README's film fits where it is shown, and shows what it says."""

import imageio.v3 as iio
import pytest

from train.pictures.hero import FPS, HOLD, SECONDS, make_hero


@pytest.mark.slow
def test_hero_film_is_small_and_ends_satisfied(tmp_path):
    path = make_hero(tmp_path / "hero.gif")
    assert path.stat().st_size <= 2e6
    film = iio.imread(path)
    assert len(film) == round(FPS * SECONDS)  # the held end is one long frame of a GIF
    assert film.shape[1:] == (640, 960, 3)
    badge = (abs(film[-1].astype(int) - (0, 128, 94)).sum(axis=2) < 40).sum()
    assert badge > 3 * 500  # three green verdicts
    assert HOLD > 0
