"""Lets Linux drop strangers' datagrams before they take a place in a socket's buffer; elsewhere nothing of it.

A flood fills the buffer faster than any program reads it, and vehicles' datagrams are lost with the others. A filter of
the kernel (classic BPF, `man 7 socket`, SO_ATTACH_FILTER) is run for each datagram as its sender sends it.
"""

from __future__ import annotations

import ctypes
import socket
import struct
import sys
from collections.abc import Collection
from contextlib import suppress
from typing import Final

_SO_ATTACH_FILTER: Final = 26
_SO_DETACH_FILTER: Final = 27
_SO_MEMINFO: Final = 55
_MEMINFO: Final = struct.Struct("9I")  # the last of which counts datagrams that were dropped
_MOST_INSTRUCTIONS: Final = 4096

_WORD, _HALF, _BYTE = 0x20, 0x28, 0x30  # load at a place of the datagram, whose UDP header is the first 8 bytes
_EQUAL, _GREATER, _JUMP, _RETURN = 0x15, 0x25, 0x05, 0x06
_ALL, _NOTHING = 0xFFFFFFFF, 0  # bytes that are let through
_SOURCE_ADDRESS: Final = 0xFFF00000 + 12  # in the IP header
_SOURCE_PORT: Final = 0
_RANDOM: Final = 0xFFFFF000 + 56
_PAYLOAD: Final = 8

_Instruction = tuple[int, int, int, int]  # code, jump if true, jump if false, operand


def program(known: Collection[tuple[str, int]], share: float) -> bytes:
    """Return a filter that lets pass what known addresses send, and of others a share of what begins as a heartbeat.

    Args:
        known: IPv4 addresses.
        share: 0 to 1.

    Raises:
        OSError: An address is none of IPv4.
        ValueError: There are too many of them.
    """
    ports: dict[int, list[int]] = {}
    for host, port in known:
        ports.setdefault(int.from_bytes(socket.inet_aton(host), "big"), []).append(port)
    sections: list[list[_Instruction]] = [
        [
            (_HALF, 0, 0, _SOURCE_PORT),
            *(each for port in of_host for each in ((_EQUAL, 0, 1, port), (_RETURN, 0, 0, _ALL))),
        ]
        for of_host in ports.values()
    ]
    head: list[_Instruction] = [(_WORD, 0, 0, _SOURCE_ADDRESS)]
    at, body = 2 + 2 * len(ports), list[_Instruction]()
    end = at + sum(len(section) + 1 for section in sections)
    for address, section in zip(ports, sections, strict=True):
        head += [(_EQUAL, 0, 1, address), (_JUMP, 0, 0, at + len(body) - len(head) - 2)]
        body += [*section, (_JUMP, 0, 0, end - at - len(body) - len(section) - 1)]
    head.append((_JUMP, 0, 0, end - at))
    instructions = [*head, *body, *_heartbeats(share)]
    if len(instructions) > _MOST_INSTRUCTIONS:
        raise ValueError(f"{len(known)} addresses are too many for one filter")
    return b"".join(struct.pack("HBBI", *each) for each in instructions)


def _heartbeats(share: float) -> list[_Instruction]:
    """Return what lets a share of the datagrams pass that begin with a heartbeat of component 1, of either version."""
    return [
        (_BYTE, 0, 0, _PAYLOAD),
        (_EQUAL, 0, 3, 0xFD),
        (_WORD, 0, 0, _PAYLOAD + 6),
        (_EQUAL, 4, 0, 0x01000000),
        (_RETURN, 0, 0, _NOTHING),
        (_EQUAL, 0, 5, 0xFE),
        (_HALF, 0, 0, _PAYLOAD + 4),
        (_EQUAL, 0, 3, 0x0100),
        (_WORD, 0, 0, _RANDOM),
        (_GREATER, 1, 0, min(int(share * 2**32), 2**32 - 1)),
        (_RETURN, 0, 0, _ALL),
        (_RETURN, 0, 0, _NOTHING),
    ]


def attach(own: socket.socket, known: Collection[tuple[str, int]] | None, share: float) -> bool:
    """Let the system drop what the filter of `program` does not let pass; None: nothing. Tell whether it does that."""
    if not sys.platform.startswith("linux") or own.family != socket.AF_INET:
        return False
    try:
        if known is None:
            with suppress(OSError):  # there was none
                own.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
            return False
        code = program(known, share)
        kept = ctypes.create_string_buffer(code, len(code))  # the system copies it
        head = struct.pack("HL", len(code) // 8, ctypes.addressof(kept))
        own.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, head)
    except (OSError, ValueError):
        return False
    return True


def dropped_by_system(own: socket.socket) -> int:
    """Return how many datagrams for this socket the system has dropped, by a filter or for want of room; 0: unknown."""
    if sys.platform.startswith("linux"):
        with suppress(OSError, struct.error):
            told: int = _MEMINFO.unpack(own.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[-1]
            return told
    return 0
