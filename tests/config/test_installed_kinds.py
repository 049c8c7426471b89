"""Kinds of sensors that the project does not know: what an installed package offers."""

import os
import subprocess
import sys


def test_a_kind_of_an_installed_package_is_loaded_where_a_configuration_names_it(tmp_path):
    info = tmp_path / "sonar_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: sonar-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[holdfast.sensors]\nsonar = sonar_package\n")
    (tmp_path / "sonar_package.py").write_text(
        "from typing import Literal\n"
        "from holdfast.config.model import register_kind\n"
        "from holdfast.config.section import Topic\n"
        "from holdfast.config.sensors import MountedConfig\n"
        "class SonarConfig(MountedConfig):\n    kind: Literal['sonar']\n    topic: Topic\n"
        "register_kind(SonarConfig)\n"
    )
    text = "sensors: {imu: {kind: imu, topic: /imu}, depth: {kind: sonar, topic: /sonar, frame: imu}}"
    program = f"from holdfast.config.load import parse_config; print(parse_config({text!r}).sensors['depth'].kind)"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "sonar\n", done.stderr
