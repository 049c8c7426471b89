"""The plan of a batch: one job per recording and variation of the configuration."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Any

from holdfast import __version__
from holdfast.config.document import plain, read_document
from holdfast.config.legacy import modernised
from holdfast.config.load import read_yaml, resolved_yaml, validate
from holdfast.config.model import Config
from holdfast.config.presets import with_preset
from holdfast.errors import ConfigError, RecordingError
from holdfast.recording.source import is_shipped
from holdfast.replay.held_out import HoldOut, check_sensors

SAFE = set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._=+-@")


@dataclass(frozen=True, slots=True)
class Variation:
    """Values that one key of the configuration takes, one after the other.

    Attributes:
        key: with dots, such as `graph.lag_s`.
        values: as YAML.
    """

    key: str
    values: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> "Variation":
        """Read `graph.lag_s=1.5,3,6`.

        Raises:
            ConfigError: it has another form.
        """
        key, equals, values = text.partition("=")
        variation = cls(key.strip(), tuple(value.strip() for value in values.split(",")))
        if not equals or not all(key.strip() for key in variation.key.split(".")) or not all(variation.values):
            raise ConfigError(f"--vary {text}: expected KEY=VALUE,VALUE,..., such as graph.lag_s=1.5,3,6")
        return variation


@dataclass(frozen=True, slots=True)
class Job:
    """One replay; it can be sent to another process.

    Attributes:
        name: of its folder, unique in the batch.
        changes: key -> value of what was varied.
        arguments: options for `holdfast replay` beside these.
        fingerprint: of everything that its results depend on.
    """

    name: str
    recording: Path
    folder: Path
    config_yaml: str
    changes: tuple[tuple[str, str], ...]
    arguments: tuple[str, ...]
    fingerprint: str


def plan(
    recordings: Sequence[Path],
    config: Path,
    variations: Sequence[Variation],
    output: Path,
    arguments: Sequence[str] = (),
    *,
    rules: Sequence[HoldOut] = (),
) -> list[Job]:
    """Return the jobs of a batch, by recording, then by variation in the order given.

    Raises:
        ConfigError: the configuration or a variation of it holds mistakes, or has no sensor that a rule names; a key is
            varied twice, or two jobs would have one name.
        RecordingError: there is no file or folder at the path of a recording.
    """
    keys = [variation.key for variation in variations]
    if len(set(keys)) < len(keys):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ConfigError(f"--vary {twice}: is given twice (allowed: --vary {twice}=VALUE,VALUE,...)")
    configs = [_varied(config, changes, rules) for changes in _choices(variations)]
    names = _names(recordings)
    jobs = []
    for given, name in zip(recordings, names, strict=True):
        recording = given if is_shipped(given) else given.resolve()
        state = _state(recording)
        for changes, text in configs:
            of = "".join(f"@{key}={value}" for key, value in changes)
            full = "".join(letter if letter in SAFE else "_" for letter in name + of)
            folder = output.resolve() / full
            made_of = [__version__, str(recording), state, text, *arguments]
            fingerprint = sha256(json.dumps(made_of).encode()).hexdigest()[:16]
            jobs.append(Job(full, recording, folder, text, changes, tuple(arguments), fingerprint))
    same = sorted({job.name for job in jobs if sum(other.name == job.name for other in jobs) > 1})
    if same:
        raise ConfigError(
            f"{same[0]}: two runs of the batch would have this name; is a recording or value given twice?"
        )
    return jobs


def _choices(variations: Sequence[Variation]) -> list[tuple[tuple[str, str], ...]]:
    return list(product(*([(variation.key, value) for value in variation.values] for variation in variations)))


def _varied(
    path: Path, changes: tuple[tuple[str, str], ...], rules: Sequence[HoldOut]
) -> tuple[tuple[tuple[str, str], ...], str]:
    """Return the changes and the whole configuration with them, as YAML."""
    varied = "".join(f" with {key}={value}" for key, value in changes)
    document = read_document(read_yaml(path, "`holdfast config init RECORDING` starts one"), f"{path}{varied}")
    data: Any = document.data
    for key, value in changes:
        section, (*heads, last) = data, key.split(".")
        for head in heads:
            section = section.setdefault(head, {}) if isinstance(section, dict) else None
            if not isinstance(section, dict):
                raise ConfigError(f"--vary {key}={value}: {head} is no section of {path}")
        section[last] = _scalar(value)
    document.data = with_preset(modernised(data) if isinstance(data, dict) else data)
    found = validate(document, Config)
    check_sensors(rules, found)
    return changes, resolved_yaml(found)


def _scalar(text: str) -> Any:
    try:
        return plain(f"value: {text}", "")["value"]
    except ConfigError:
        raise ConfigError(f"--vary: {text!r:.80} is no YAML value") from None


def _names(recordings: Sequence[Path]) -> list[str]:
    """Return a name per recording: of its folder or file, and that of the folder above where several are equal."""
    plain = [path.resolve().name if path.is_dir() else path.stem for path in recordings]
    return [
        name if plain.count(name) == 1 else f"{path.resolve().parent.name}-{name}"
        for name, path in zip(plain, recordings, strict=True)
    ]


def _state(recording: Path) -> list[tuple[str, int, int]]:
    """Return the names, sizes and times of change of a recording's files, which identify it."""
    if is_shipped(recording):
        return []
    try:
        files = sorted(file for file in recording.iterdir() if file.is_file()) if recording.is_dir() else [recording]
        return [(file.name, file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    except OSError as error:
        raise RecordingError(f"{recording}: {(error.strerror or str(error)).lower()}") from None
