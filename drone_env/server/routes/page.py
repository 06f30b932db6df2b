"""The page, what stands in its head for sites that show links to it, and the picture beside such a link."""

from html import escape
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import HTMLResponse
from starlette.concurrency import run_in_threadpool

from drone_env.errors import DroneEnvError
from drone_env.server.links import HELLO, Link, draw_preview, title_of
from drone_env.server.page_files import PAGE, edition
from drone_env.server.pilots import called
from drone_env.server.problems import answers
from drone_env.server.state import Shared, SharedParts

router = APIRouter(tags=["page"])
PICTURE = {200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}}
HELLO_STYLE = "".join(f'<link rel="stylesheet" href="static/css/{name}.css">' for name in ("hello", "hello-motion"))
NAME = "Drone Delivery"
ABOUT = "A drone delivers parcels on a generated city grid. Fly it, race a network, and see what every move gave away."


@router.get("/", include_in_schema=False)
def page(request: Request, shared: SharedParts) -> Response:
    """The page; where its address asks for nothing, with a flight that moves before any script has run."""
    shared.workers.warm_up()
    html = (PAGE / "index.html").read_text(encoding="utf-8").replace("<!-- link -->", _head(request, shared))
    if not request.url.query:
        html = html.replace("<!-- hello -->", (PAGE / "hello.html").read_text(encoding="utf-8"))
        html = html.replace("</head>", f"{HELLO_STYLE}\n</head>")
    html = html.replace('="static/', f'="static/v-{edition()}/')
    return HTMLResponse(html)


@router.get("/preview.png", response_class=Response, responses=PICTURE | answers(404, 422, 503))
async def preview(request: Request, shared: SharedParts, link: Annotated[Link, Query()]) -> Response:
    """The picture for a link to the page with this query: its map, with the flight up to its step.

    A person is not flown for.
    """
    record = (await run_in_threadpool(shared.store.episode, link.episode)).record if link.episode else None
    task = link.task if record is None else record.task
    picture = await shared.work(request, draw_preview, link, record, task=task)
    return Response(picture, media_type="image/png", headers={"Cache-Control": "max-age=3600"})


def _head(request: Request, shared: Shared) -> str:
    """What sites are told that show a link to this address.

    Where the server wants a token they are told the same of all: who asks has none, and what is flown and stored here
    is not for everybody.
    """
    title, link = _told(request, shared) if shared.settings.token is None else (None, None)
    told = {"og:type": "website", "og:site_name": NAME, "og:title": title or NAME, "og:description": ABOUT}
    if link is not None:
        told["og:image"] = f"{request.base_url}preview.png?{link.query()}"
        told |= {"og:image:width": "1200", "og:image:height": "630"}
    told["twitter:card"] = "summary" if link is None else "summary_large_image"
    lines = [
        f'<meta {"name" if name.startswith("twitter") else "property"}="{name}" content="{escape(text)}">'
        for name, text in told.items()
    ]
    return "\n".join(lines)


def _told(request: Request, shared: Shared) -> tuple[str | None, Link]:
    """The title of what the address leads to, and the link whose picture goes with it.

    What leads to no flight has no title, and the picture of the flight on the page: what is wrong with an address,
    the page itself says.
    """
    try:
        link = Link.read(request.query_params)
        if link.episode:
            record = shared.store.episode(link.episode).record
            return title_of(record.task, record.seed, [called(record.agent)], link.step), link
        link.check()
        return link.title(), link
    except DroneEnvError:
        return None, HELLO
