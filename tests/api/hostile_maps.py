"""A hundred addresses draw maps of all sizes while eight people fly: how long does a frame take, in how much memory?

`hostile_callers.py` runs it.
"""

import asyncio
import contextlib
import json
import multiprocessing
import random
import time
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from websockets.asyncio.client import ClientConnection, connect

from drone_env.core.cells import Cell

SIZES = (3, 8, 16, 32, 48, 64, 96, 128)
PEOPLE, DRAWERS = 8, 100
PAUSE = 0.1
"""Seconds between two steps of a person."""


def drawing(chance: random.Random) -> dict[str, Any]:
    """A map with streets between blocks, parcels and pads."""
    side = chance.choice(SIZES)
    cells = np.full((side, side), int(Cell.BUILDING))
    cells[::4] = cells[:, ::4] = int(Cell.ROAD)
    streets = [(int(x), int(y)) for y, x in zip(*np.nonzero(cells == Cell.ROAD), strict=True)]
    start, *others = chance.sample(streets, min(len(streets), 17))
    parcels = chance.randrange(1, min(8, len(others)))
    for x, y in others[parcels : parcels + chance.randrange(8)]:
        cells[y, x] = int(Cell.PAD)
    return {"cells": cells.tolist(), "start": start, "parcels": others[:parcels]}


async def draw(url: str, number: int, until: float, seen: Counter[str]) -> None:
    """Ask what maps are worth, keep them, look at them and have a pilot fly them, from an address of its own."""
    chance = random.Random(number)
    transport = httpx.AsyncHTTPTransport(local_address=f"127.0.1.{number + 1}")
    async with httpx.AsyncClient(base_url=url, transport=transport, timeout=60) as client:
        while time.monotonic() < until:
            drawn = drawing(chance)
            task = ""
            for path in ("/maps/worth", "/maps", "/values"):
                body = {"task": task, "seed": 0} if path == "/values" else drawn
                try:
                    answer = await client.post(path, json=body)
                except httpx.HTTPError as error:
                    seen[f"{path} {type(error).__name__}"] += 1
                    continue
                seen[f"{path} {answer.status_code}"] += 1
                if path == "/maps":
                    if answer.status_code != 200:
                        break
                    task = answer.json()["task"]["id"]


def draw_all(url: str, seconds: float, told: Connection) -> None:
    """The process of those who draw."""
    seen: Counter[str] = Counter()

    async def run() -> None:
        until = time.monotonic() + seconds
        await asyncio.gather(*[draw(url, number, until, seen) for number in range(DRAWERS)])

    asyncio.run(run())
    told.send(seen)


async def fly(socket: ClientConnection, until: float, took: list[float]) -> None:
    """Fly by hand, and note how long each frame takes."""

    async def told(kind: str) -> None:
        while json.loads(await socket.recv())["type"] != kind:
            pass

    steps = 0
    while time.monotonic() < until:
        if steps % 100 == 0:
            await socket.send('{"type":"start","task":"hard","pilots":["human"]}')
            await told("flights")
        steps += 1
        began = time.monotonic()
        await socket.send(json.dumps({"type": "fly", "direction": random.choice(("UP", "DOWN", "LEFT", "RIGHT"))}))
        await told("frames")
        took.append(time.monotonic() - began)
        await asyncio.sleep(PAUSE)


async def fly_all(url: str, seconds: float) -> list[float]:
    """The seconds that each frame of eight people takes."""
    took: list[float] = []
    async with contextlib.AsyncExitStack() as opened:
        address = url.replace("http", "ws", 1) + "/live"
        sockets = [await opened.enter_async_context(connect(address)) for _ in range(PEOPLE)]
        until = time.monotonic() + seconds
        await asyncio.gather(*[fly(socket, until, took) for socket in sockets])
    return took


def memory(process: int) -> float:
    """Megabytes of a process and its children; what they share counts once (Linux)."""
    total, todo = 0, [process]
    while todo:
        one = todo.pop()
        with contextlib.suppress(OSError):
            for children in Path(f"/proc/{one}/task").glob("*/children"):
                todo += map(int, children.read_text().split())
            total += int(Path(f"/proc/{one}/smaps_rollup").read_text().partition("\nPss:")[2].split()[0])
    return total / 1024


async def crowd(url: str, process: int, seconds: float) -> tuple[list[float], list[float], float, Counter[str]]:
    """Frame times before and while maps are drawn, the most memory meanwhile, and what those who draw were answered."""
    before = await fly_all(url, seconds)
    told, telling = multiprocessing.Pipe(duplex=False)
    drawers = multiprocessing.Process(target=draw_all, args=(url, seconds, telling), daemon=True)
    drawers.start()
    flying = asyncio.create_task(fly_all(url, seconds))
    most = 0.0
    while not flying.done():
        most = max(most, await asyncio.to_thread(memory, process))
        await asyncio.sleep(PAUSE)
    seen = await asyncio.to_thread(told.recv)
    drawers.join()
    return before, flying.result(), most, seen
