"""Tables 5.1 to 5.3 of the thesis ("From Faces to Outdoor Light Probes"), as printed.

Mean and standard deviation of seven metrics (``docs/architecture.md`` and
``skylight.imaging.metrics`` say how each is computed here) for each light model.
"""

from dataclasses import dataclass

METRICS = ("mae", "rmse", "si_rmse", "full_dw_mae", "sky_dw_mae", "sun_dw_mae", "sun_angle_deg")
Figures = tuple[float, ...]  # in the order of METRICS


@dataclass(frozen=True, kw_only=True)
class ThesisTable:
    """One printed table: ``means`` and ``deviations`` by method, in the order of METRICS."""

    title: str
    means: dict[str, Figures]
    deviations: dict[str, Figures]

    def mean(self, method: str, metric: str) -> float:
        return self.means[method][METRICS.index(metric)]

    def std(self, method: str, metric: str) -> float:
        return self.deviations[method][METRICS.index(metric)]


TABLE_5_1 = ThesisTable(
    title="The thesis, Table 5.1 (mean ± standard deviation over 135 captured skies)",
    means={
        "sh9": (0.56, 0.64, 0.50, 0.47, 0.46, 0.43, 20.29),
        "sh25": (0.53, 0.62, 0.48, 0.41, 0.45, 0.42, 13.93),
        "sunsky": (0.54, 0.37, 0.23, 0.40, 0.18, 0.06, 0.68),
        "autoencoder_feedforward": (1.54, 1.05, 0.14, 0.50, 0.23, 0.10, 4.61),
        "autoencoder": (0.35, 0.29, 0.17, 0.30, 0.22, 0.16, 6.52),
    },
    deviations={
        "sh9": (0.62, 0.69, 0.53, 0.26, 0.25, 0.26, 22.64),
        "sh25": (0.62, 0.70, 0.53, 0.26, 0.25, 0.26, 14.39),
        "sunsky": (0.43, 0.28, 0.21, 0.18, 0.14, 0.10, 1.52),
        "autoencoder_feedforward": (4.69, 3.06, 0.16, 0.70, 0.27, 0.10, 13.63),
        "autoencoder": (0.32, 0.29, 0.19, 0.21, 0.22, 0.20, 14.51),
    },
)
TABLE_5_2 = ThesisTable(
    title="The thesis, Table 5.2 (mean ± standard deviation over 135 faces)",
    means={
        "sh9": (0.68, 0.53, 0.41, 1.04, 0.43, 0.35, 18.31),
        "sh25": (0.71, 0.52, 0.43, 1.22, 0.46, 0.34, 22.38),
        "sunsky": (0.92, 0.71, 0.55, 1.42, 0.64, 0.26, 42.23),
        "autoencoder": (0.75, 0.60, 0.45, 0.80, 0.62, 0.15, 23.55),
    },
    deviations={
        "sh9": (0.39, 0.30, 0.22, 0.48, 0.23, 0.20, 19.52),
        "sh25": (0.51, 0.33, 0.22, 0.37, 0.21, 0.21, 18.54),
        "sunsky": (0.56, 0.47, 0.39, 1.57, 0.42, 0.20, 30.31),
        "autoencoder": (0.38, 0.33, 0.29, 0.27, 0.32, 0.12, 21.75),
    },
)
TABLE_5_3 = ThesisTable(
    title="The thesis, Table 5.3 (mean ± standard deviation over 131 photographs)",
    means={
        "sh9": (1.39, 0.95, 0.58, 1.65, 0.49, 0.32, 45.88),
        "sh25": (0.99, 0.71, 0.57, 1.29, 0.46, 0.36, 28.67),
        "sunsky": (1.11, 0.85, 0.53, 1.73, 1.25, 0.64, 41.58),
        "autoencoder": (0.86, 0.65, 0.49, 1.22, 0.86, 0.19, 33.30),
    },
    deviations={
        "sh9": (0.91, 0.58, 0.32, 0.73, 0.26, 0.20, 46.72),
        "sh25": (0.44, 0.31, 0.24, 0.31, 0.23, 0.21, 28.49),
        "sunsky": (0.75, 0.64, 0.24, 1.75, 1.57, 1.36, 36.48),
        "autoencoder": (0.36, 0.29, 0.18, 0.34, 0.36, 0.11, 30.20),
    },
)
# which evaluation's page shows which table
BESIDE = {
    "sky-models": TABLE_5_1,
    "synthetic-faces": TABLE_5_2,
    "rendered-faces": TABLE_5_2,
    "rendered-faces-hosek-wilkie": TABLE_5_2,
    "captured-faces": TABLE_5_3,
}
