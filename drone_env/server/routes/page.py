"""The page, and the reference of all calls."""

from html import escape

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drone_env.flights.provenance import HUMAN
from drone_env.server import daily
from drone_env.server.page_files import PAGE
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["page"], include_in_schema=False)


@router.head("/")
@router.get("/")
def page(request: Request, app_state: AppStateDep) -> Response:
    """The page; without a query it greets the visitor before its scripts run."""
    app_state.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- base -->", escape(str(request.base_url)))
    if request.url.query:
        html = html.replace('id="hello"', 'id="hello" hidden')
    return HTMLResponse(html.replace("<!-- today -->", _today()))


@router.head("/docs")
@router.get("/docs")
async def docs() -> Response:
    """The reference of all calls."""
    return FileResponse(PAGE / "docs.html")


def _today() -> str:
    """The link to the map of the day."""
    day = daily.today()
    task, seed = daily.map_of_the_day(day)
    link = f"?task={task}&seed={seed}&pilot={HUMAN}"
    data = f'id="today" data-task="{task}" data-seed="{seed}" data-tasks="{" ".join(daily.DAILY)}"'
    return f'<a class="button primary" {data} href="{escape(link)}">Map of the day, {day.day} {day:%B}</a>'
