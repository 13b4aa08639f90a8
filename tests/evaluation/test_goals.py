"""What the published tables were made with, and which numbers are goals: as the pages say."""

from dataclasses import fields
from pathlib import Path

import pytest

from skylight.evaluation import (
    _any_light as any_light,
    _face_sensitivity as face_sensitivity,
    _known_faces as known_faces,
    _lamps as lamps,
    _lit_object as lit_object,
    _partition_probe as partition_probe,
    _partition_scene as partition_scene,
    _relit_lamps as relit_lamps,
    _relit_portraits as relit_portraits,
    _relit_scores as relit_scores,
    _shared_light as shared_light,
    _sky_fits as sky_fits,
    _sky_models as sky_models,
    _sky_representations as sky_representations,
    _sparse_coding as sparse_coding,
    _sparse_inverse as sparse_inverse,
    _synthetic_faces as synthetic_faces,
    _tables as tables,
    _transport_compression as compression,
    _voxel_probe as voxel_probe,
)
from skylight.evaluation._main import EVALUATIONS

SETTINGS = {
    "sky-models": {"count": 150, "seed": 30_000_000},
    "sky-representations": {"count": 45, "seed": 30_000_000},
    "light-representations": {"count": None, "seed": 0},
    "sparse-coding": {
        "height": 128,
        "counts": (4, 16, 36, 64, 100, 144),
        "indoor": None,
        "outdoor": None,
        "learned": 100,
        "learned_from": 100,
        "seed": 0,
    },
    "sparse-inverse": {"every": 3, "counts": (4, 16, 36, 64, 100), "seed": 0},
    "transport-compression": {
        "rows": 1000,
        "chunk": 25,
        "nonnegative_every": 10,
        "timed_rows": 60,
        "seed": 0,
    },
    "voxel-probe": {
        "maps": 8,
        "models": 3,
        "samples": 256,
        "best": 12,
        "every_set": 1,
        "seed": 0,
    },
    "partition-probe": {
        "indoor": 100,
        "sunny": 100,
        "samples": 1024,
        "rays": 256,
        "even": (6, 14, 38, 110),
        "width": 192,
        "searches": 4,
        "steps": 4000,
        "turns": 4,
        "seed": 0,
    },
    "synthetic-faces": {
        "count": None,
        "size": 256,
        "seed": 20_000_000,
        "methods": ("sphere", "sh9", "sh25", "sunsky", "autoencoder", "lamps", "auto"),
        "ablation": False,
    },
    "real-faces": {"every": 1, "seed": 0},
    "lamps": {"every": 1, "ablation": False, "seed": 0},
    "any-light": {
        "count": None,
        "methods": ("sphere", "sh25", "autoencoder", "lamps", "auto"),
        "seed": 0,
    },
    "shared-light": {"scenes": None, "seed": 0},
    "face-sensitivity": {
        "count": 24,
        "size": 360,
        "seed": 20_000_000,
        "sizes": (90, 128, 192, 256, 360),
        "angles_deg": (0.0, 5.0, 10.0, 15.0, 20.0, 25.0, 30.0),
        "sigmas": (0.0, 0.275, 0.55, 0.825, 1.1),
        "methods": ("sh9", "sh25", "sunsky", "autoencoder"),
    },
    "relit-portraits": {"count": None, "seed": 0},
    "relit-lamps": {"sources": 3, "targets": 3, "peers": (), "seed": 0},
    "speed": {"count": 12, "runs": ((1, 1), (2, 1), (2, 16)), "seed": 0},
}


@pytest.mark.parametrize("name", EVALUATIONS)
def test_a_usual_run_has_the_settings_of_the_published_tables(name: str) -> None:
    own = {field.name: field.default for field in fields(EVALUATIONS[name])}
    for given in ("data", "model", "options"):  # by the command
        own.pop(given, None)
    assert own == SETTINGS[name]


def test_goals_are_those_that_the_pages_state() -> None:
    assert any_light.MEDIAN_DEG == 12
    assert any_light.MEAN_FOUND == 0.70
    assert any_light.SI_RMSE_RATIO == 0.6
    assert any_light.BETTER_SHARE == 0.9
    assert any_light.COVERED == (0.85, 0.95)
    assert any_light.LEVELS == {
        "whole_colour": 0.07,
        "lower_colour": 0.10,
        "whole_level": 0.25,
        "lower_level": 0.20,
        "log_radiance": 0.65,
    }
    assert (any_light.DARK, any_light.BLUR_DEG) == (0.01, 3)
    assert face_sensitivity.MOST_GROWTH == 0.2
    assert known_faces.CHOSEN == 0.9
    assert lamps.BY_LAMPS_DEG == 5
    assert (lamps.FOUND, lamps.MEDIAN_DEG, lamps.MEAN_DEG, lamps.BIAS_DEG) == (0.97, 6, 9, 2)
    assert (lamps.TRUSTED_DEG, lamps.TRUSTED_SHARE) == (10, 0.85)
    assert lamps.COVERED == (0.85, 0.95)
    assert (lamps.POSE_SCATTER_DEG, lamps.POSE_MEDIAN_DEG, lamps.POSE_WORST_DEG) == (1.5, 2, 8)
    assert relit_portraits.GOALS == {"": (0.5, 26), "_skin": (0.45, 28)}
    assert (relit_portraits.LEAST_SSIM, relit_portraits.BLOTCH_RATIO) == (0.88, 0.7)
    assert relit_lamps.RMSE_RATIO == 0.5
    assert shared_light.BETTER == 0.6
    assert (shared_light.COUNTS, shared_light.TOGETHER) == ((1, 2, 4), 4)
    assert sky_models.SIMULATED_GOALS == {
        "mae": 0.25,
        "rmse": 0.22,
        "si_rmse": 0.12,
        "full_dw_mae": 0.25,
        "sky_dw_mae": 0.15,
        "sun_dw_mae": 0.05,
        "sun_angle_deg": 0.7,
    }
    assert sky_models.FEED_FORWARD_MAE == 0.5
    assert sky_models.REAL_SUN_ANGLE_DEG == 3
    every = ("sh9", "sh25", "sunsky", "autoencoder_feedforward")
    assert {
        "mae": every,
        "rmse": every,
        "full_dw_mae": every,
        "si_rmse": ("sh25", "sunsky"),
        "sky_dw_mae": ("sh25",),
        "sun_dw_mae": ("sh25",),
    } == sky_models.REAL_GOALS
    assert synthetic_faces.MEAN_GOALS == {
        "mae": 0.45,
        "rmse": 0.35,
        "si_rmse": 0.25,
        "full_dw_mae": 0.60,
        "sky_dw_mae": 0.35,
        "sun_dw_mae": 0.12,
        "sun_angle_deg": 8,
    }
    assert synthetic_faces.MEDIAN_GOALS == {"sun_angle_deg": 4}
    assert synthetic_faces.COVERED == (0.80, 0.97)
    assert synthetic_faces.OURS_RATIO == 1.03
    assert (synthetic_faces.SKIES_KEPT, synthetic_faces.AUTO_RATIO) == (0.95, 1.05)
    assert (synthetic_faces.WORST_TONE, synthetic_faces.FEWEST_OF_A_TONE) == (1.5, 3)
    assert synthetic_faces.KNOWN_WITHIN == 0.01


def test_what_is_measured_is_as_the_thesis_has_it_or_the_pages_say() -> None:
    assert any_light.LARGE_SHARE == 0.2
    assert (any_light.MAIN_SHARE, any_light.NEAR_DEG, any_light.NO_LAMP_DEG) == (0.4, 20, 90)
    assert any_light.COMPARED == ("mae", "rmse", "full_dw_mae")
    assert compression.COUNTS == (1, 9, 25, 49)
    assert (compression.HEIGHT, compression.CUBE, compression.LIGHTS) == (32, 32, 4)
    assert (compression.BANDS, compression.ANISOTROPIC) == (24, 36)
    assert (compression.POSITIONS.rows, compression.POSITIONS.twists) == (16, 16)
    assert (lit_object.PIXELS, lit_object.HEIGHT) == (1477, 96)
    assert lamps.METHODS == ("sphere", "autoencoder", "lamps", "auto")
    assert lamps.SKIN_TINT == (1.0, 0.66, 0.51)
    assert (relit_lamps.LIT_SHARE, relit_lamps.MAP_ROWS) == (0.6, 128)
    assert (relit_scores.BLOTCH_PX, relit_scores.BLOTCH_PERCENTILE) == (9, 99)
    assert partition_probe.ORDER == ("110d", "sh25", "38d", "sh9", "14d", "6d")
    assert partition_probe.OUTDOOR == ("14d-outdoor", "14d-sun-12")
    assert partition_probe.THESIS_MAE == {"sh25": 0.138, "38d": 0.210, "110d": 0.114}
    assert (partition_probe.THESIS_MEAN, partition_probe.LIGHT_HEIGHT) == (0.9, 128)
    assert (partition_scene.ALBEDO, partition_scene.DEGREE) == (0.8, 4)
    assert partition_scene.MODELS == ("stanford_bunny.ply", "stanford_dragon.ply", "spot.ply")
    assert (sky_fits.HELD, sky_fits.RELEASED) == (50, 30)
    assert sky_fits.LossWeights() == sky_fits.LossWeights(radiance=1.0, log=1.0, shading=2.0)
    assert sky_representations.DEGREES == (2, 3, 4, 5, 6, 9)
    assert sky_representations.QUANTILE == 0.98
    assert sparse_coding.CODERS == ("iso", "ani", "kmeans", "vmf")
    assert sparse_coding.SIGNS == {"nnls": "nonnegative", "l1": "l1"}
    assert sparse_coding.BANDS == {"vmf": (True,), "box": (False,)}
    assert (sparse_coding.RATE, sparse_coding.SHARPEST) == (0.03, 4096)
    assert sparse_coding.FLOATS == {"sh": 3, "sh_windowed": 3, "haar": 4, "sg": 6}
    assert (sparse_coding.SHOWN, sparse_coding.CUBE, sparse_coding.STEPS) == (64, 64, 80)
    assert (sparse_inverse.HEIGHT, sparse_inverse.FINE_HEIGHT) == (32, 64)
    assert (sparse_inverse.NOISE, sparse_inverse.RIDGE) == (1e-3, 1e-3)
    assert sparse_inverse.RIDGES == (1e-2, 1e-3, 1e-4, 1e-5)
    assert (sparse_inverse.BY_LAMPS, sparse_inverse.LEAST_COMPARED) == (16, 16)
    assert sparse_inverse.OUTDOOR_STEP == 6
    assert sparse_inverse.CODES == {
        "ani_nnls": ("ani", "nonnegative"),
        "ani_l1": ("ani", "l1"),
        "iso_nnls": ("iso", "nonnegative"),
        "vmf_nnls": ("vmf", "nonnegative"),
    }
    assert voxel_probe.THESIS_L1 == {
        "probe3_direct": 0.0115,
        "probe3_global": 0.0113,
        "probe5_direct": 0.0113,
        "probe5_global": 0.0094,
    }
    assert voxel_probe.ORDER == (
        ("probe3_global", "probe3_direct"),
        ("probe5_global", "probe5_direct"),
        ("probe5_direct", "probe3_direct"),
        ("probe5_global", "probe3_global"),
    )
    assert (voxel_probe.ALBEDO, voxel_probe.PIXELS, voxel_probe.RESOLUTION) == (0.8, 160, 24)
    assert (voxel_probe.PROBES, voxel_probe.LIGHT_HEIGHT) == ((3, 5), 128)
    assert voxel_probe.VIEWS_DEG == ((35.0, 25.0), (215.0, 25.0))


def test_every_number_has_a_label_and_every_table_its_neighbour() -> None:
    assert (
        *("mae", "rmse", "si_rmse", "full_dw_mae", "sky_dw_mae", "sun_dw_mae", "sun_angle_deg"),
    ) == tables.METRICS
    assert list(tables.LABELS) == [
        *("mae", "rmse", "si_rmse", "mae_aligned", "rmse_aligned", "brightness", "ssim"),
        *("full_dw_mae", "sky_dw_mae", "sun_dw_mae", "sun_dw_mae_fixed", "sun_angle_deg"),
        *("main_lamp_deg", "lamps_found", "whole_colour", "whole_level", "lower_colour"),
        *("lower_level", "log_radiance", "mirror_si_rmse", "silver_si_rmse", "diffuse_si_rmse"),
        *("mirror_angle_deg", "silver_angle_deg", "diffuse_angle_deg"),
        *("pose_deg", "in_region", "region_sr", "psnr"),
        *("tone_mapped_ssim", "floats", "floats_per_activation", "l2", "srgb_rmse", "srgb_psnr"),
        *("srgb_ssim", "blotch", "srgb_rmse_skin", "srgb_psnr_skin", "srgb_ssim_skin"),
        *("blotch_skin", "seconds", "cpu_seconds", "photos_per_minute"),
        *("seconds_of_a_photo", "transport_seconds", "peak_mib"),
    ]
    assert tables.BESIDE == {
        "sky-models": tables.TABLE_5_1,
        "synthetic-faces": tables.TABLE_5_2,
        "rendered-faces": tables.TABLE_5_2,
        "rendered-faces-hosek-wilkie": tables.TABLE_5_2,
        "captured-faces": tables.TABLE_5_3,
    }
    for table in (tables.TABLE_5_1, tables.TABLE_5_2, tables.TABLE_5_3):
        methods = [name for name in table.rows if name != "autoencoder_feedforward"]
        assert methods == ["sh9", "sh25", "sunsky", "autoencoder"]
    assert "autoencoder_feedforward" in tables.TABLE_5_1.rows
    # Gardner et al. 2023, at 27, 108, 147 and 300 floats
    (_, columns, rows), (_, *same), (_, spheres, published) = tables.PEERS.values()
    assert same == [columns, rows]
    assert all(len(cells) == len(spheres) for _, cells in published)
    # Liang et al. 2025, Table 1
    assert dict(published)["DiffusionLight, Poly Haven"] == [
        "0.113", "0.270", "0.519", "2.199", "3.121", "4.104",
    ]  # fmt: skip
    assert columns == ["27 floats", "108 floats", "147 floats", "300 floats"]
    assert dict(rows) == {
        "RENI++": ["18.02", "20.87", "21.13", "22.10"],
        "SH": ["15.00", "17.88", "18.23", "19.15"],
        "spherical Gaussians": ["17.67", "19.27", "19.81", "20.24"],
    }
    assert tables.GROUPED_BY == (
        "category",
        "background",
        "direction",
        "half",
        "regime",
        "skin tone",
    )


def test_an_index_of_maps_is_part_of_what_results_depend_on(tmp_path: Path) -> None:
    (tmp_path / "index.csv").write_text("file,category\na.exr,indoor\n")
    first = EVALUATIONS["sparse-coding"].over(tmp_path).config()
    assert "data" not in first  # wherever it lies
    (tmp_path / "index.csv").write_text("file,category\nb.exr,indoor\n")
    assert EVALUATIONS["sparse-coding"].over(tmp_path).config() != first
