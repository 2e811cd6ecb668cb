"""Messages of records from JSON."""

from __future__ import annotations

import math
import typing
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from mdm import messages
from mdm.recording import schemas
from mdm.recording.stimuli import Said, Stimulus

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Decoding"]

_STRUCTS = {
    each: kind
    for each in messages.__all__
    if isinstance(kind := getattr(messages, each), type) and issubclass(kind, messages.Message)
}


class Decoding:
    """Decodes messages as structs, by the names of their schemas.

    Args:
        types: Types by the names of schemas, beside those of `mdm.messages` and the stimuli.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        kinds: dict[str, Any] = {schemas.name(kind): kind for kind in _STRUCTS.values()}
        kinds |= {schemas.name(Stimulus): Stimulus, **types}
        self._kinds = kinds
        self._decoders: dict[str, msgspec.json.Decoder[Any]] = {}

    def decode(self, schema_name: str, data: bytes) -> Any:
        """Return a message: a struct, or what JSON has where its type is unknown or has other fields."""
        kind = self._kinds.get(schema_name)
        if kind is None:
            return msgspec.json.decode(data)
        decoder = self._decoders.get(schema_name)
        if decoder is None:
            decoder = self._decoders[schema_name] = msgspec.json.Decoder(kind, dec_hook=_restore)
        try:
            message = decoder.decode(data)
        except msgspec.ValidationError:
            return _converted(msgspec.json.decode(data), kind)
        if isinstance(message, Said) and message.type in _STRUCTS:
            said = _converted(message.message, _STRUCTS[message.type])
            return msgspec.structs.replace(message, message=said)
        return message


def _restore(kind: Any, value: Any) -> Any:
    """Return an array from a list, in which JSON has null for what is no number."""
    if (typing.get_origin(kind) or kind) is np.ndarray:
        array = np.array([math.nan if each is None else each for each in value], dtype=float)
        array.flags.writeable = False
        return array
    raise NotImplementedError


def _converted(value: Any, kind: Any) -> Any:
    """Return a struct from what JSON has; without one that fits, the value as it is.

    JSON has null for numbers that are none, or infinite: they are restored as not a number.
    """
    try:
        return msgspec.convert(value, kind, dec_hook=_restore)
    except msgspec.ValidationError:
        pass
    if isinstance(value, dict) and isinstance(kind, type):
        numbers = {field for field, hint in typing.get_type_hints(kind).items() if hint is float}
        restored = {key: math.nan if each is None and key in numbers else each for key, each in value.items()}
        try:
            return msgspec.convert(restored, kind, dec_hook=_restore)
        except msgspec.ValidationError:
            pass
    return value
