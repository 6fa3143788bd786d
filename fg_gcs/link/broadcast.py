"""Lines for other programs on this machine, over a local (Unix domain) socket whose readers cannot hold us up."""

from __future__ import annotations

import asyncio
import hashlib
import os
import tempfile
from pathlib import Path
from typing import Final, cast

from fg_gcs.errors import LinkError

MOST_READERS: Final = 16  # each costs a copy of every line
MOST_PATH_BYTES: Final = 100  # the system's own limit is 104 or 108


class _Reader(asyncio.Protocol):
    """One program that reads; what it says is never read."""

    def __init__(self, readers: set[_Reader]) -> None:
        self.transport: asyncio.WriteTransport | None = None
        self._readers = readers

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the transport (asyncio calls this)."""
        self.transport = cast("asyncio.Transport", transport)
        if len(self._readers) >= MOST_READERS:
            self.transport.abort()
        else:
            self._readers.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it (asyncio calls this)."""
        self._readers.discard(self)


class LineBroadcast:
    """Sends lines to whoever is connected; one that has not taken the line before misses this one.

    Attributes:
        path: of the socket.
        missed: lines that slow readers did not get.
    """

    def __init__(self, path: Path, server: asyncio.AbstractServer, readers: set[_Reader]) -> None:
        """Take an open server: :meth:`open` makes one."""
        self.path = path
        self.missed = 0
        self._server = server
        self._readers = readers

    @classmethod
    async def open(cls, folder: Path, name: str) -> LineBroadcast:
        """Open a socket in a folder, or, where its path would be too long for one, in the system's temporary folder.

        Only this user can connect.

        Raises:
            LinkError: it cannot be opened.
        """
        path = folder / name
        if len(os.fsencode(path.absolute())) > MOST_PATH_BYTES:
            path = (
                Path(tempfile.gettempdir())
                / f"fg-gcs-{hashlib.sha256(os.fsencode(path.absolute())).hexdigest()[:16]}-{name}"
            )
        readers: set[_Reader] = set()
        try:
            path.unlink(missing_ok=True)
            server = await asyncio.get_running_loop().create_unix_server(lambda: _Reader(readers), path)
            path.chmod(0o600)
        except OSError as error:
            raise LinkError(f"{path}: {error.strerror or error}") from error
        return cls(path, server, readers)

    @property
    def has_readers(self) -> bool:
        """Tell whether any program is connected."""
        return bool(self._readers)

    def send(self, line: str) -> None:
        """Send one line to everyone who has taken the one before."""
        data = line.encode() + b"\n"
        for reader in tuple(self._readers):
            transport = reader.transport
            if transport is None or transport.is_closing():
                continue
            if transport.get_write_buffer_size() > 0:
                self.missed += 1
            else:
                transport.write(data)

    def close(self) -> None:
        """Close the socket and every connection; may be called twice."""
        self._server.close()
        for reader in tuple(self._readers):
            if reader.transport is not None:
                reader.transport.abort()
        self.path.unlink(missing_ok=True)
