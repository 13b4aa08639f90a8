import torch

from skylight.skies.surroundings._scenes import surroundings


# of 16 x 64: scenes are the same at any height, and cost a quarter of those of 32 x 128
def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_the_generator_alone_decides() -> None:
    skies = torch.rand(12, 16, 64, 3, generator=generator())
    one, two, other = (surroundings(skies, generator(seed)) for seed in (1, 1, 2))
    assert all(torch.equal(a, b) for a, b in zip(one, two, strict=True))
    assert not torch.equal(one[0], other[0])


def test_more_stands_below_than_above_and_nothing_outshines_a_uniform_sky() -> None:
    """Albedos are below 1: before a sky of radiance 1 a surface sends less, and air as much."""
    cover, radiance = surroundings(torch.ones(60, 16, 64, 3), generator(2))
    assert ((cover >= 0) & (cover <= 1 + 1e-5)).all()
    assert ((radiance >= 0) & (radiance <= 1 + 1e-4)).all()
    rows = cover.mean(dim=(0, 2, 3))
    assert float(rows[-1]) > 0.5 > 0.2 > float(rows[:4].mean())
    assert float(radiance[cover[..., 0] > 0.9].median()) < 0.3


def test_twice_the_light_is_sent_back_twice() -> None:
    skies = torch.rand(8, 16, 64, 3, generator=generator())
    skies[:, 9, 32] = 800.0
    (cover, one), (same, two) = (surroundings(k * skies, generator(3)) for k in (1, 2))
    torch.testing.assert_close(same, cover, rtol=0, atol=0)
    torch.testing.assert_close(two, 2 * one, rtol=1e-4, atol=1e-6)


def test_a_map_of_twice_the_height_shows_the_same_scene() -> None:
    small = torch.ones(24, 16, 64, 3)
    small[:12, 10, 32] = 1000.0
    large = small.repeat_interleave(2, 1).repeat_interleave(2, 2)
    (cover, light), (fine, finer) = (surroundings(each, generator(4)) for each in (small, large))

    def halved(image: torch.Tensor) -> torch.Tensor:
        return image.unflatten(1, (16, 2)).mean(2).unflatten(2, (64, 2)).mean(3)

    assert float((halved(fine) - cover).abs().mean()) < 0.01
    assert abs(float((fine.mean() - cover.mean()) / cover.mean())) < 0.01
    sent, shown = cover * light, halved(fine * finer)
    assert float((shown - sent).abs().mean()) < 0.1 * float(sent.mean())


def test_walls_opposite_the_sun_are_the_brightest() -> None:
    """The sun, in column 32, shines on what the observer sees in column 0."""
    skies = torch.full((60, 16, 64, 3), 0.1)
    skies[:, 10, 32] = 1000.0
    cover, radiance = surroundings(skies, generator(3))
    sent = (cover * radiance).sum((0, 1, 3)) / cover.sum((0, 1, 3))
    assert float(sent[[0, 1, 62, 63]].mean()) > 2 * float(sent[30:35].mean())


def test_the_sun_is_seldom_hidden_and_without_it_nothing_overhead_is_left_out() -> None:
    """Suns at four heights, each before 150 scenes; then scenes without one.

    Where nothing casts a shadow the zenith is covered as often as places near it.
    """
    free, _ = surroundings(torch.ones(240, 16, 64, 3), generator(6))
    rows = free.mean((0, 2, 3))
    assert float(rows[0]) > 0.7 * float(rows[2])
    for row in (2, 5, 8, 13):
        skies = torch.full((150, 16, 64, 3), 0.1)
        skies[:, row, 32] = 1000.0
        cover, _ = surroundings(skies, generator(5))
        hidden = float((cover[:, row, 32] > 0.5).float().mean())
        assert hidden < 0.5 * float((free[:, row] > 0.5).float().mean()), row
