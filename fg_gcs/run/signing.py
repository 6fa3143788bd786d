"""The keys that a run signs with, and its time stamps, which never run back even if the clock does."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable, Collection, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Final

from fg_gcs.errors import MissionError
from fg_gcs.link.clock import ticks
from fg_gcs.link.key_file import read_key
from fg_gcs.record.write.kept_stamp import KEEP_EVERY_S, KeptStamp
from fg_gcs.wire.address import MAIN
from fg_gcs.wire.signing import Signing, Stamps, stamp_of

_NAMED: Final = re.compile(r"(?:(?P<network>[a-z0-9_-]{1,16})=)?(?P<file>.+)", re.DOTALL)


def key_files(texts: Sequence[str], networks: Collection[str]) -> dict[str, Path]:
    """Return the key file of each network, from texts of the form ``[NAME=]FILE``; without a name it is for all others.

    Args:
        texts: as people give them; a file whose name looks like ``NAME=FILE`` is written ``./NAME=FILE``.
        networks: names of all networks that there are.

    Raises:
        MissionError: a text is at fault.
    """
    named: dict[str | None, Path] = {}
    for text in texts:
        match = _NAMED.fullmatch(text)
        if match is None:
            raise MissionError("--signing-key: an empty text; accepted: [NAME=]FILE")
        network = None if set(networks) == {MAIN} else match["network"]  # the only one needs no name
        if network is not None and network not in networks:
            raise MissionError(f"--signing-key {text}: no network {network!r}; there are {', '.join(networks)}")
        if network in named:
            raise MissionError(f"--signing-key {text}: {network or 'a network'} has a key already")
        named[network] = Path(match["file"])
    files = {network: named.get(network, named.get(None)) for network in networks}
    return {network: file for network, file in files.items() if file is not None}


def keys_in(files: Mapping[str, Path]) -> dict[str, bytes]:
    """Return the keys of networks.

    Raises:
        MissionError: a file cannot be read, others may read it, or it holds no key.
    """
    return {network: read_key(file) for network, file in files.items()}


@asynccontextmanager
async def signing_with(
    keys: Mapping[str, bytes],
    epoch_s: float,
    folder: Path | None,
    warn: Callable[[str], None],
    *,
    sets_up: bool = False,
) -> AsyncIterator[Mapping[str, Signing]]:
    """Sign with keys, by the loop's time from now on; keep on disk up to which stamp frames are signed.

    Args:
        keys: by the names of networks.
        epoch_s: what the wall clock shows now [s since 1970].
        folder: where stamps are kept; None: nothing has to outlive the run.
        warn: told once what the disk does not take.
        sets_up: vehicles do not have the keys yet, see `Signing`.
    """
    if not keys:
        yield {}
        return
    loop = asyncio.get_running_loop()
    kept = None if folder is None else KeptStamp(folder)
    stamps = Stamps(loop.time, max(stamp_of(epoch_s), 0 if kept is None else kept.read()))
    signing = {network: Signing(key, stamps, sets_up=sets_up) for network, key in keys.items()}
    if kept is None:
        yield signing
        return
    told = _Once(warn)
    await _keep(kept, stamps, told)
    keeper = asyncio.ensure_future(_go_on_keeping(kept, stamps, told))
    try:
        yield signing
    finally:
        keeper.cancel()
        await asyncio.gather(keeper, return_exceptions=True)


class _Once:
    """Tells the first of what there is to tell."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell: Callable[[str], None] | None = tell

    def __call__(self, text: str) -> None:
        """Tell, or not."""
        tell, self._tell = self._tell, None
        if tell is not None:
            tell(text)


async def _go_on_keeping(kept: KeptStamp, stamps: Stamps, warn: Callable[[str], None]) -> None:
    loop = asyncio.get_running_loop()
    async for _ in ticks(loop.time() + KEEP_EVERY_S, KEEP_EVERY_S):
        await _keep(kept, stamps, warn)


async def _keep(kept: KeptStamp, stamps: Stamps, warn: Callable[[str], None]) -> None:
    try:
        await asyncio.to_thread(kept.keep, stamps.now())
    except OSError as error:
        warn(f"the time stamp of signatures cannot be kept: {error.strerror or error}")
