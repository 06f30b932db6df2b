"""The routes of the map editor: a map as a drawing, the optimum of a drawing, and drawings stored as tasks."""

from contextlib import suppress
from typing import Annotated, Literal, get_args

import numpy as np
from fastapi import APIRouter, Body, Path, Request, Response
from pydantic import ConfigDict, Field, JsonValue
from starlette.concurrency import run_in_threadpool
from typing_extensions import Self

from drone_env.city.city_file import MAX_TEXT, City, city_text, parse_city
from drone_env.core.cells import CELL_KINDS, Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import MAX_DELIVERIES, MAX_SIDE, TaskConfig, get_task
from drone_env.core.terrain import PLACED
from drone_env.errors import InvalidTaskError, TooLargeError
from drone_env.models import MAX_SEED, Count, StrictModel
from drone_env.server.drawn_maps import drawn_task, name_of
from drone_env.server.exceptions import error_responses
from drone_env.server.frames import BestFlight, best_flight
from drone_env.server.routes.catalogue import OneTask, describe
from drone_env.server.state import AppStateDep

router = APIRouter(prefix="/maps", tags=["maps"])
REFUSALS = error_responses(400, 413, 415, 422, 503)
DrawnNumber = Literal["max_steps", "battery_capacity", "charge_rate"]
Pair = Annotated[list[Count], Field(min_length=2, max_length=2)]
"""A `Position` as a list, because API test tools do not support tuples in requests."""
EXAMPLE: JsonValue = {"cells": [[0, 1, 0], [0, 3, 0], [0, 0, 8]], "start": [0, 0], "parcels": [[2, 0]]}
KINDS = ", ".join(f"{kind:d} {CELL_KINDS[kind].name}" for kind in PLACED)


class DrawnMap(StrictModel):
    """A drawing: the file of a city as JSON, with start and parcels."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE]})

    cells: list[Annotated[list[int], Field(max_length=MAX_SIDE, fail_fast=True)]] = Field(
        max_length=MAX_SIDE, fail_fast=True, description=f"[y][x], kinds of the cells: {KINDS}."
    )
    start: Pair = Field(description="[x, y] where the drone starts; a road.")
    parcels: list[Pair] = Field(
        min_length=1, max_length=MAX_DELIVERIES, fail_fast=True, description="[x, y] of each parcel; roads."
    )
    numbers: dict[DrawnNumber, int] = Field(default={}, description="Numbers other than the defaults.")
    attribution: str = Field(default="", max_length=MAX_TEXT, description="Owner and licence of the terrain data.")

    @classmethod
    def of(cls, city: City) -> Self:
        """A city as a drawing; its map 0 if the city generates maps.

        Raises:
            InvalidTaskError: if the city is not a valid task.
        """
        drawn = cls.from_episode(Episode(drawn_task(city, "city"), seed=0))
        numbers = {name: number for name, number in city.numbers.items() if name in drawn.numbers}
        return drawn.model_copy(update={"numbers": numbers})

    @classmethod
    def from_episode(cls, episode: Episode) -> Self:
        """The map of an episode at its start as a drawing."""
        task, (x, y) = episode.task, episode.position
        cells = episode.grid()
        cells[y, x] = episode.under
        cells[cells == Cell.DELIVERY] = Cell.ROAD
        return cls(
            cells=cells.tolist(),
            start=[x, y],
            parcels=[[px, py] for px, py, _ in episode.parcels],
            numbers=_numbers(episode),
            attribution=task.attribution,
        )

    def city(self) -> City:
        """The city of the drawing.

        Raises:
            InvalidTaskError: if it is not a valid city.
        """
        widths, kinds = {len(row) for row in self.cells}, {kind for row in self.cells for kind in row}
        if len(widths) != 1:
            raise InvalidTaskError("cells must be rows of equal width")
        if not kinds <= set(PLACED):
            raise InvalidTaskError(f"cells must be {KINDS}; got {min(kinds.difference(PLACED))}")
        return City(
            np.array(self.cells, np.uint8),
            self.attribution,
            start=(self.start[0], self.start[1]),
            parcels=tuple((x, y) for x, y in self.parcels),
            numbers={str(name): number for name, number in self.numbers.items()},
        )


class MapWorth(StrictModel):
    """The optimum of a drawing, and its file."""

    name: str = Field(description="Name of its task if it is stored.")
    toml: str = Field(description="Its city file, which every command accepts.")
    numbers: dict[DrawnNumber, Count] = Field(description="The numbers of its task.")
    optimum: BestFlight | None = Field(description="A best flight; null if the map is too large to be solved.")


@router.get("/{task_name}/{seed}", response_model=DrawnMap, responses=error_responses(404, 422, 503))
async def drawn_map(
    request: Request, app_state: AppStateDep, task_name: str, seed: Annotated[int, Path(ge=0, le=MAX_SEED)]
) -> Response:
    """A map as a drawing. The rules of drawings are those of `skyline`."""
    return await app_state.json(request, _drawing, task_name, seed, task=task_name)


@router.post("/file", response_model=DrawnMap, responses=REFUSALS)
async def file_as_map(request: Request, app_state: AppStateDep, toml: Annotated[str, Body(embed=True)]) -> Response:
    """The file of a city as a drawing; its map 0 if the city generates maps."""
    return await app_state.json(request, _file_as_map, toml)


@router.post("/worth", response_model=MapWorth, responses=REFUSALS)
async def worth(request: Request, app_state: AppStateDep, drawn: Annotated[DrawnMap, Body()]) -> Response:
    """The optimum of a drawing, and the text of its file."""
    return await app_state.json(request, _worth, drawn)


@router.post("", responses=REFUSALS)
async def keep_map(request: Request, app_state: AppStateDep, drawn: Annotated[DrawnMap, Body()]) -> OneTask:
    """Store a drawing as a task. Its name is a digest of the drawing; its only map is number 0.

    Callers find it by its name; no list contains it.
    """
    text, task = await app_state.work(request, _checked, drawn)
    await run_in_threadpool(app_state.maps.keep, text, task.id)
    return await run_in_threadpool(describe, task, app_state)


def _checked(drawn: DrawnMap) -> tuple[str, TaskConfig]:
    city = drawn.city()
    text = city_text(city)
    return text, drawn_task(city, name_of(text.encode()))


def _drawing(task_name: str, seed: int) -> str:
    return DrawnMap.from_episode(Episode(get_task(task_name), seed=seed)).model_dump_json()


def _file_as_map(toml: str) -> str:
    return DrawnMap.of(parse_city(toml)).model_dump_json()


def _worth(drawn: DrawnMap) -> str:
    city = drawn.city()
    text = city_text(city)
    episode = Episode(drawn_task(city, "map"), seed=0)
    optimum = None
    with suppress(TooLargeError):
        optimum = best_flight(episode.task, episode.seed)
    name, numbers = name_of(text.encode()), _numbers(episode)
    return MapWorth(name=name, toml=text, numbers=numbers, optimum=optimum).model_dump_json()


def _numbers(episode: Episode) -> dict[DrawnNumber, int]:
    return {name: getattr(episode.task, name) for name in get_args(DrawnNumber)}
