"""The page, and the `meta` elements by which other sites preview a link to it."""

from datetime import datetime, timezone
from html import escape
from urllib.parse import urlencode

from fastapi import APIRouter, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.core.tasks import MAX_UNITS, TaskConfig, get_task
from drone_env.errors import DroneEnvError, InvalidValueError, UnknownNameError
from drone_env.models import Seed
from drone_env.server.map_choice import DEFAULT_TASK, map_of_the_day
from drone_env.server.page_files import PAGE, edition
from drone_env.server.pilots import HUMAN, all_pilots, display_name
from drone_env.server.sessions import LONGEST_ID
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["page"])
STYLES = "".join(f'<link rel="stylesheet" href="static/css/{name}.css">' for name in ("hello", "hello-motion"))
NAME = "Drone Delivery"
ABOUT = "A drone delivers parcels on a generated city grid. Fly it, race a network, and see what every move gave away."


class Link(BaseModel):
    """The query of a link to the page. Unknown parameters are ignored: sites add their own, the page reads more."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    task: str = Field(default=DEFAULT_TASK, max_length=100, description="Id or short name of the task.")
    seed: Seed | None = Field(default=None, description="Number of the map.")
    pilot: str = Field(default="", max_length=100, description="Id of the pilot.")
    pilots: str | None = Field(default=None, max_length=400, description="Pilots of a race, separated by commas.")
    profile: str = Field(default=ORIGINAL_PROFILE, max_length=100, description="Id of the reward profile.")
    step: int | None = Field(default=None, ge=0, le=MAX_UNITS, description="The step to show; the last by default.")
    episode: str | None = Field(
        default=None, max_length=LONGEST_ID, description="Id of a stored episode; replaces task, seed and pilots."
    )

    @property
    def first_pilot(self) -> str:
        """Id of the first pilot; empty if the link names none."""
        return (self.pilot if self.pilots is None else self.pilots).partition(",")[0]

    def start(self) -> Episode:
        """The map of the link, with the drone at its start.

        Raises:
            UnknownNameError: if the task, the pilot or the reward profile does not exist.
            InvalidValueError: if the link names no map.
        """
        task = get_task(self.task)
        if self.seed is None:
            raise InvalidValueError("the link names no map: it requires task=hard&seed=7, or episode=ID")
        if self.first_pilot and self.first_pilot not in all_pilots():
            raise UnknownNameError("pilot", self.first_pilot, all_pilots())
        return Episode(task, self.profile, self.seed)

    def query(self) -> str:
        """The query string, without the ignored parameters."""
        return urlencode(self.model_dump(exclude_defaults=True), safe=",")


FIRST_PAINT = Link(task="skyline_medium", seed=43, pilot="tournet")
"""The flight that the page shows before its scripts run and link previews show; `tools/first_paint.py` draws it."""


@router.get("/", include_in_schema=False)
def page(request: Request, shared: AppStateDep) -> Response:
    """The page; without a query it contains a flight that moves before its scripts run."""
    shared.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- link -->", _head(request, shared))
    if not request.url.query:
        hello = (PAGE / "first_paint.html").read_text(encoding="utf-8")
        html = html.replace("<!-- hello -->", hello.replace("<!-- today -->", _today()))
        html = html.replace("</head>", f"{STYLES}\n</head>")
    html = html.replace('="static/', f'="static/v-{edition()}/')
    return HTMLResponse(html)


def _today() -> str:
    """The link to the map of the day."""
    day = datetime.now(timezone.utc)
    task, seed = map_of_the_day(day)
    link = Link(task=task, seed=seed, pilot=HUMAN).query()
    return f'<a class="button" href="?{escape(link)}">Map of the day, {day.day} {day:%B}</a>'


def _head(request: Request, shared: AppState) -> str:
    """The `meta` elements for link previews.

    If the server requires a token they are the same for every address, since stored flights are not public.
    """
    title = None if shared.settings.token is not None else _title(request, shared)
    meta = {"og:type": "website", "og:site_name": NAME, "og:title": title or NAME, "og:description": ABOUT}
    meta |= {"og:image": f"{request.base_url}static/preview.png", "twitter:card": "summary_large_image"}
    lines = [
        f'<meta {"name" if name.startswith("twitter") else "property"}="{name}" content="{escape(text)}">'
        for name, text in meta.items()
    ]
    return "\n".join(lines)


def _title(request: Request, shared: AppState) -> str | None:
    """The title of the flight in the address; None without one."""
    try:
        link = Link.model_validate(dict(request.query_params))
        if link.episode:
            record = shared.store.episode(link.episode).record
            name, task, seed = display_name(record.agent), record.task, record.seed
        else:
            start, pilot = link.start(), link.first_pilot
            name = "Fly it yourself" if pilot == HUMAN else all_pilots()[pilot].name if pilot else ""
            task, seed = start.task.id, start.seed
        title = f"{_task_name(get_task(task))}, map {seed}"
    except (DroneEnvError, ValidationError):
        return None
    title = f"{name}: {title}" if name else title
    return title if link.step is None else f"{title}, step {link.step}"


def _task_name(task: TaskConfig) -> str:
    """The name of a task for people, as the page writes it: `Skyline Hard`, `Drawn map aadb`."""
    name = task.short_name
    return f"Drawn map {name[6:10]}" if task.family == "drawn" else name.replace("_", " ").title()
