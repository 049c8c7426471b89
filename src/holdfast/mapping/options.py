"""How a map is made; checked before anything else is imported."""

from dataclasses import dataclass

from holdfast.errors import ConfigError


@dataclass(frozen=True, slots=True)
class SiteMapOptions:
    """How a map is made.

    Attributes:
        voxel_m: side of a voxel, of which one point is kept.
        max_range_m: farther points are left out: an error of attitude moves them most.
        max_points_per_scan: a denser scan is thinned evenly.
        max_gap_s: a scan over a longer gap of the trajectory is left out.
        keep_above: a cell is thinned out if fewer of the rays that reach it end there than this fraction; 0 keeps all.

    Raises:
        ConfigError: a number with which no map can be made.
    """

    voxel_m: float = 0.1
    max_range_m: float = 50.0
    max_points_per_scan: int = 20_000
    max_gap_s: float = 0.5
    keep_above: float = 0.2

    def __post_init__(self) -> None:
        """Refuse numbers with which no map can be made."""
        if not 0.01 <= self.voxel_m <= 10.0:
            raise ConfigError(f"--voxel {self.voxel_m:g}: must be from 0.01 to 10 m")
        if not 1.0 <= self.max_range_m <= 1000.0:
            raise ConfigError(f"--max-range {self.max_range_m:g}: must be from 1 to 1000 m")
        if not 0.0 <= self.keep_above <= 1.0:
            raise ConfigError(f"--keep-above {self.keep_above:g}: must be from 0 to 1")
