"""Web socket frames of a browser, and the messages among them that Meshcat may get."""

import base64
import binascii
from collections.abc import Iterator
from typing import Annotated, Literal

import msgpack
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from websockets import utils
from websockets.frames import Frame, Opcode
from websockets.protocol import Protocol, Side, State

from mirdrake.core.errors import MirdrakeError

MOST = 65536
"""Largest size of a message [byte]."""

BINARY, CLOSE, PING, PONG = Opcode.BINARY, Opcode.CLOSE, Opcode.PING, Opcode.PONG


class ProtocolError(MirdrakeError):
    """Bytes that are not web socket frames of a client."""


def accept_key(key: str) -> str | None:
    """Return the server's answer to a client's ``Sec-WebSocket-Key``; None if that is not a key."""
    try:
        if len(base64.b64decode(key, validate=True)) != 16:
            return None
    except (binascii.Error, ValueError):
        return None
    return utils.accept_key(key)


class FrameReader:
    """Splits what a client sends into complete messages (RFC 6455, without extensions)."""

    def __init__(self) -> None:
        self._protocol = Protocol(Side.SERVER, state=State.OPEN, max_size=MOST)
        self._message = bytearray()
        self._opcode = Opcode.CONT  # of the message whose fragments are being collected

    def feed(self, data: bytes) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and payload of each message that is complete.

        Raises:
            ProtocolError: the bytes are not masked frames of a client, or a message is larger than :data:`MOST`.
        """
        if self._protocol.state is not State.OPEN:
            return  # what follows a close frame is ignored
        self._protocol.receive_data(data)
        self._protocol.data_to_send()  # Meshcat answers pings and the close frame
        for frame in self._protocol.events_received():
            assert isinstance(frame, Frame)
            # Control frames may come between the fragments of a message.
            if frame.opcode >= CLOSE:
                yield frame.opcode, bytes(frame.data)
                continue
            # Only the first fragment has the opcode, the following ones have 0.
            self._opcode = self._opcode or frame.opcode
            self._message += frame.data
            if frame.fin:
                yield self._opcode, bytes(self._message)
                self._opcode, self._message = Opcode.CONT, bytearray()
        if self._protocol.parser_exc is not None:
            raise ProtocolError(str(self._protocol.parser_exc))


def make_frame(opcode: int, payload: bytes) -> bytes:
    """Return a whole message as one frame of a client."""
    # Clients must mask their frames (RFC 6455).
    return Frame(Opcode(opcode), payload).serialize(mask=True)


def is_event(payload: bytes) -> bool:
    """Whether a binary message is an event of Meshcat's page: a button, a slider or a game pad.

    The camera's pose is not passed on: Meshcat's thread ends on one that is not a rotation, and nothing here reads it.
    """
    try:
        # No extension types: their decoders are not needed and would be a way in.
        _EVENT.validate_python(msgpack.unpackb(payload, max_ext_len=0))
    except (ValueError, ValidationError, msgpack.UnpackException):
        return False
    return True


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Button(_Strict):
    type: Literal["button"]
    name: str


class _Slider(_Strict):
    type: Literal["slider"]
    name: str
    value: float


class _PadState(_Strict):
    index: Annotated[int, Field(ge=0, lt=64)] | None = None
    button_values: list[float] = Field([], max_length=64)
    axes: list[float] = Field([], max_length=64)


class _Pad(_Strict):
    type: Literal["gamepad"]
    name: str = ""
    gamepad: _PadState | None = None


_EVENT: TypeAdapter[_Button | _Slider | _Pad] = TypeAdapter(
    Annotated[_Button | _Slider | _Pad, Field(discriminator="type")]
)
