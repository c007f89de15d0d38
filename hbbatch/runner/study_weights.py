"""Weights that studies train: each once, and again never where they are kept."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from hbbatch import __version__
from hbbatch.model.train_settings import TrainSettings
from hbbatch.runner.labelled import LabelledSequences, labelled_sequences
from hbbatch.runner.train import train


@dataclass(frozen=True)
class StudyWeights:
    """A folder of weights, named by what they were trained with.

    Variants that only track differently share theirs; a study that was interrupted goes on with
    what its folder holds.
    """

    folder: Path

    def trained(
        self, roots: Sequence[Path], settings: TrainSettings, kind: str, hold_out: Sequence[str]
    ) -> Path:
        """Weights trained on all labelled sequences of `roots` but those held out.

        Raises:
            DatasetError: a dataset is missing or holds too little.
        """
        used, _ = labelled_sequences(roots).split(hold_out)
        path = self.folder / f"{_name(used, settings, kind)}.safetensors"
        if not path.is_file():
            self.folder.mkdir(parents=True, exist_ok=True)
            train(roots, path, settings, kind=kind, hold_out=hold_out)
        return path


def _name(used: LabelledSequences, settings: TrainSettings, kind: str) -> str:
    """Kind and hash of all that decides the weights: settings, sequences and their content."""
    content = [
        (row["sequence_id"], row["content_hash"])
        for dataset, ids in used.parts
        for row in dataset.catalog().select(["sequence_id", "content_hash"]).to_pylist()
        if row["sequence_id"] in ids
    ]
    decides = repr((__version__, settings.model_dump_json(), used.names, content))
    return f"{kind}-{hashlib.sha256(decides.encode()).hexdigest()[:16]}"
