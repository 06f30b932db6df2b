"""The page, and the previews of links to it: `meta` elements and a picture."""

from html import escape
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import ValidationError
from starlette.concurrency import run_in_threadpool

from drone_env.errors import DroneEnvError
from drone_env.server.exceptions import error_responses
from drone_env.server.links import FIRST_PAINT, Link, draw_preview
from drone_env.server.page_files import PAGE, edition
from drone_env.server.state import AppState, AppStateDep

router = APIRouter(tags=["page"])
PICTURE = {200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}}
STYLES = "".join(f'<link rel="stylesheet" href="static/css/{name}.css">' for name in ("hello", "hello-motion"))
NAME = "Drone Delivery"
ABOUT = "A drone delivers parcels on a generated city grid. Fly it, race a network, and see what every move gave away."


@router.get("/", include_in_schema=False)
def page(request: Request, shared: AppStateDep) -> Response:
    """The page; without a query it contains a flight that moves before its scripts run."""
    shared.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- link -->", _head(request, shared))
    if not request.url.query:
        html = html.replace("<!-- hello -->", (PAGE / "first_paint.html").read_text(encoding="utf-8"))
        html = html.replace("</head>", f"{STYLES}\n</head>")
    html = html.replace('="static/', f'="static/v-{edition()}/')
    return HTMLResponse(html)


@router.get("/preview.png", response_class=Response, responses=PICTURE | error_responses(404, 422, 503))
async def preview(request: Request, shared: AppStateDep, link: Annotated[Link, Query()]) -> Response:
    """The picture of a link: its map with the flight of its first pilot, or a stored episode, up to its step."""
    record = (await run_in_threadpool(shared.store.episode, link.episode)).record if link.episode else None
    task = link.task if record is None else record.task
    picture = await shared.work(request, draw_preview, link, record, task=task)
    return Response(picture, media_type="image/png", headers={"Cache-Control": "max-age=3600"})


def _head(request: Request, shared: AppState) -> str:
    """The `meta` elements for link previews.

    If the server requires a token they are the same for every address, since stored flights are not public.
    """
    title, link = (None, None) if shared.settings.token is not None else _title(request, shared)
    meta = {"og:type": "website", "og:site_name": NAME, "og:title": title or NAME, "og:description": ABOUT}
    if link is not None:
        meta["og:image"] = f"{request.base_url}preview.png?{link.query()}"
        meta |= {"og:image:width": "1200", "og:image:height": "630"}
    meta["twitter:card"] = "summary" if link is None else "summary_large_image"
    lines = [
        f'<meta {"name" if name.startswith("twitter") else "property"}="{name}" content="{escape(text)}">'
        for name, text in meta.items()
    ]
    return "\n".join(lines)


def _title(request: Request, shared: AppState) -> tuple[str | None, Link]:
    """The title and the link of the address; no title and the first flight of the page if the address has no flight."""
    try:
        link = Link.model_validate(dict(request.query_params))
        return link.title(shared.store.episode(link.episode).record if link.episode else None), link
    except (DroneEnvError, ValidationError):
        return None, FIRST_PAINT
