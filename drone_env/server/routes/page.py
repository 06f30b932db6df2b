"""The page, and the reference of all calls."""

from contextlib import suppress
from datetime import datetime, time, timedelta, timezone
from functools import lru_cache
from html import escape

from fastapi import APIRouter, Request, Response
from fastapi.responses import FileResponse, HTMLResponse

from drone_env.errors import StoreError
from drone_env.flights.provenance import HUMAN
from drone_env.flights.store import Store
from drone_env.results.folder import SHIPPED, stored_results
from drone_env.server import daily
from drone_env.server.page_files import PAGE
from drone_env.server.state import AppStateDep

router = APIRouter(tags=["page"], include_in_schema=False)
SHOWN_TASK, SHOWN_NETWORK = "skyline_medium", "tournet"
"""The greeting reports the shipped results of this network over this task."""


@router.head("/")
@router.get("/")
def page(request: Request, app_state: AppStateDep) -> Response:
    """The page; without a query it greets the visitor before its scripts run."""
    app_state.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- base -->", escape(str(request.base_url)))
    if request.url.query:
        html = html.replace('id="hello"', 'id="hello" hidden')
    else:
        html = html.replace("<!-- yesterday -->", _yesterday(app_state.store))
    sentence, link = _unseen()
    html = html.replace("<!-- unseen -->", sentence).replace("<!-- failure -->", link)
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


def _yesterday(store: Store) -> str:
    """The link to yesterday's map beside its best flight, if somebody has flown it."""
    day = daily.today() - timedelta(1)
    task, seed = daily.map_of_the_day(day)
    with suppress(StoreError):  # the page opens without a store and shows its errors
        for best in store.best(task, seed, datetime.combine(day, time(), timezone.utc).timestamp(), 1):
            link = f"?task={task}&seed={seed}&pilot={HUMAN}&ghost={best.id}"
            flown = f"{100 * best.score:.1f}" + (f" by {best.person}" if best.person else "")
            return f'<a href="{escape(link)}">Fly against the best of yesterday, {escape(flown)}</a>'
    return ""


@lru_cache(maxsize=1)
def _unseen() -> tuple[str, str]:
    """What the network scores over the unseen maps, and the link to the one over which it loses most."""
    ((results,),) = (repeats for agent, repeats in stored_results(SHIPPED, SHOWN_TASK) if agent == SHOWN_NETWORK)
    columns = (results.scores, results.optimal_scores, results.success)
    score, optimum, delivered = (f"{100 * column.mean():.1f}" for column in columns)
    sentence = (
        f"Over {len(results.seeds):,} unseen maps, a trained network scores {score} of {optimum} possible and delivers"
        f" everything on {delivered} %."
    )
    worst = (results.optimal_scores - results.scores).argmax()
    link = f"?task={SHOWN_TASK}&seed={results.seeds[worst]}&pilot={SHOWN_NETWORK}&step={results.steps[worst]}"
    return sentence, f'<a class="button" href="{escape(link)}">See it fail</a>'
