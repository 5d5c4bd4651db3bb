"""What is told of a walk: its figures under names that say their units, for programs and for people."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from valor.analysis.walk import Figures, Timeliness


@dataclass(frozen=True)
class WalkReport:
    """How well a robot walked, and how well its computer kept time meanwhile."""

    figures: Figures
    timeliness: Timeliness

    def named(self) -> dict[str, Any]:
        """For programs: each name ends with its unit; counts have none."""
        figures, timeliness = self.figures, self.timeliness
        x, y, z = figures.dcm_error
        return {
            "dcm_error_rms_m": {"x": x, "y": y, "z": z},
            "smallest_knee_angle_rad": figures.knee,
            "torque_saturations": figures.saturations,
            "foot_force_error_rms_n": figures.force_error,
            "foot_force_error_median_n": figures.force_error_median,
            "solver_failures": figures.qp_failures,
            "ticks": figures.ticks,
            "tick_median_s": figures.tick_median,
            "tick_p99_s": figures.tick_99,
            "deadlines_missed": timeliness.deadlines_missed,
            "waits_timed_out": timeliness.waits_timed_out,
            "clock_slip_s": timeliness.slip,
        }

    def rows(self) -> list[tuple[str, str]]:
        """For people: what, and how much."""
        figures, timeliness = self.figures, self.timeliness
        x, y, z = (1e3 * each for each in figures.dcm_error)
        return [
            ("DCM error, rms", f"{x:.1f}, {y:.1f}, {z:.1f} mm (x, y, z)"),
            ("smallest knee angle", f"{figures.knee:.2f} rad"),
            ("torques clamped at their limit", str(figures.saturations)),
            (
                "vertical foot force, planned against measured",
                f"{figures.force_error:.0f} N rms, {figures.force_error_median:.1f} N median",
            ),
            ("solver failures", str(figures.qp_failures)),
            ("tick", f"{1e3 * figures.tick_median:.2f} ms median, {1e3 * figures.tick_99:.2f} ms p99"),
            ("deadlines missed", f"{timeliness.deadlines_missed} of {figures.ticks}"),
            ("waits timed out", str(timeliness.waits_timed_out)),
            ("clock slip", f"{timeliness.slip:.2f} s"),
        ]
