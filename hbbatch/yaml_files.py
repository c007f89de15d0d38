"""YAML as users write it, safely loaded.

A module of its own, for a worker reads none: loading the parser takes longer than most files.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from hbbatch.errors import ConfigError


class _UniqueKeys(yaml.SafeLoader):
    """The safe loader, but of a key that is given twice the last does not silently win."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """See `yaml.composer.Composer`."""
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and (key.tag, key.value) in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"{key.value!r} is given twice", key.start_mark
                )
            seen.add((key.tag, str(key.value)))
        return node


def load_yaml(path: Path) -> dict[str, Any]:
    """The mapping in a YAML file, safely loaded.

    Raises:
        ConfigError: the file is missing, no YAML, or no mapping, or gives a key twice.
    """
    try:
        content = yaml.load(path.read_text(), Loader=_UniqueKeys)  # noqa: S506 - it is a safe one
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}). Check the path.") from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not valid YAML ({' '.join(str(error).split())}).") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: holds a {type(content).__name__}, expected a mapping of keys.")
    return content
