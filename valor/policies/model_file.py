"""An ONNX file: inputs, outputs, metadata, and evaluation by ONNX Runtime on one thread of the CPU."""

from __future__ import annotations

import math
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from valor.common.errors import ConfigurationError

MAX_BYTES = 100 << 20
_INSTALL = "pip install 'valor[policies]'"
_TYPES: dict[str, Any] = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(int64)": np.int64}
# Words of ONNX Runtime's messages, what is wrong then, and what is expected.
_CAUSES = {
    "protobuf parsing failed": ("is not an ONNX file", "a model exported as ONNX"),
    "no graph": ("is not an ONNX file", "a model exported as ONNX"),
    "opset": ("has an opset that ONNX Runtime does not support", "an export with an older opset"),
    "external": ("its external data are missing or invalid", "the data file next to it, or an export in one file"),
}


@dataclass(frozen=True)
class Tensor:
    """An input or output; sizes that the file leaves open are 1."""

    name: str
    shape: tuple[int, ...]
    kind: Any  # NumPy's; None: a type that policies do not use

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)


def _tensors(found: Any) -> dict[str, Tensor]:
    shapes = {each.name: tuple(n if isinstance(n, int) else 1 for n in each.shape) for each in found}
    return {each.name: Tensor(each.name, shapes[each.name], _TYPES.get(each.type)) for each in found}


class ModelFile:
    """A model in memory; ``inputs`` and ``outputs`` by name, ``metadata`` as texts by key."""

    def __init__(self, file: Path) -> None:
        """Read a file. Raises ConfigurationError: missing, too large, not ONNX, or not accepted by ONNX Runtime."""
        self.file = file
        try:
            found = file.stat()
        except OSError as error:
            raise ConfigurationError(f"{file}: {error.strerror}; expected an ONNX file") from None
        if not stat.S_ISREG(found.st_mode):
            raise ConfigurationError(f"{file}: is no regular file; expected an ONNX file")
        beside = (each for each in file.parent.glob(f"{file.stem}*.data") if each.is_file())  # external data
        if (size := found.st_size + sum(each.stat().st_size for each in beside)) > MAX_BYTES:
            what = f"has {size >> 20} MiB; expected a policy of at most {MAX_BYTES >> 20} MiB"
            raise ConfigurationError(f"{file}: {what}")
        try:
            import onnxruntime as runtime
        except ImportError:
            raise ConfigurationError(f"{file}: onnxruntime is not installed here: {_INSTALL}") from None
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4  # it writes no lines of its own
        try:
            self._session = runtime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        except Exception as error:
            raise self._cause(error) from None
        self.inputs = _tensors(self._session.get_inputs())
        self.outputs = _tensors(self._session.get_outputs())
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def run(self, values: Mapping[str, npt.ArrayLike]) -> dict[str, npt.NDArray[Any]]:
        """Evaluate: a value of every input to the outputs, flat; values are shaped and converted as the file states."""
        feeds = {
            name: np.ascontiguousarray(values[name], tensor.kind).reshape(tensor.shape)
            for name, tensor in self.inputs.items()
        }
        return {name: each.ravel() for name, each in zip(self.outputs, self._session.run(None, feeds), strict=True)}

    def require_finite(self) -> None:
        """Raise ConfigurationError if outputs for inputs of zero are not finite, or cannot be computed."""
        try:
            found = self.run({name: np.zeros(tensor.shape) for name, tensor in self.inputs.items()})
        except Exception as error:
            what = f"cannot be evaluated ({_line(error)})"
            raise ConfigurationError(f"{self.file}: {what}; expected outputs for inputs of zero") from None
        for name, values in found.items():
            if not np.isfinite(values.astype(float)).all():
                what = f"output {name!r} is not finite for inputs of zero"
                raise ConfigurationError(f"{self.file}: {what}; expected weights without NaN and infinity")

    def _cause(self, error: Exception) -> ConfigurationError:
        text, otherwise = str(error).lower(), (f"ONNX Runtime rejects it ({_line(error)})", "a valid ONNX file")
        what, expected = next((cause for word, cause in _CAUSES.items() if word in text), otherwise)
        return ConfigurationError(f"{self.file}: {what}; expected {expected}")


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
