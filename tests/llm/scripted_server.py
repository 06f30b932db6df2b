"""A scripted OpenAI-compatible server: `python scripted_server.py PORT`.

`POST /NAME/script` opens an endpoint at `/NAME/v1`. Its body contains:
- `log`: a file. Each request is a line in it before it is answered, and a second line after that.
- `pilot`: perfect, greedy, plan, able (perfect or greedy, as the prompt allows), or a text to answer with.
- `repair`: the same, for repair prompts.
- `latency`: seconds.
- `faults`: a list of [first, last, fault] by the number of the request from 0; the first match applies.
"""

import asyncio
import json
import re
import sys
from pathlib import Path

from drone_env.core.actions import Action
from drone_env.planning.optimal import shortest_tour, tour_actions
from drone_env.planning.tours import route

POINT = re.compile(r"\((\d+), (\d+)\)")


def points(text: str, label: str) -> list[tuple[int, int]]:
    line = next(line for line in text.splitlines() if line.startswith(label))
    return [(int(x), int(y)) for x, y in POINT.findall(line)]


def number(text: str, pattern: str) -> int:
    return int(re.search(pattern, text)[1])


def tour(text: str, budget: int) -> list[Action]:
    start = points(text, "Position:")[0]
    return tour_actions(start, shortest_tour(start, points(text, "Parcels to deliver:"), budget))


def reply(pilot: str, prompt: str) -> str:
    if pilot == "able":
        pilot = "perfect" if "Parcels to deliver:" in prompt else "greedy"
    if pilot == "perfect":
        return tour(prompt, number(prompt, r"(\d+) units"))[0].name
    if pilot == "plan":
        return json.dumps({"actions": [a.name for a in tour(prompt, number(prompt, r"Steps left: (\d+)"))]})
    if pilot == "greedy":
        return next(iter(route(points(prompt, "Position:")[0], points(prompt, "Target:")[0])), Action.WAIT).name
    return pilot


channels: dict[str, dict] = {}
"""The script of each endpoint, and how many requests it got (`count`)."""


def log(script: dict, line: dict) -> None:
    with Path(script["log"]).open("a") as file:
        file.write(json.dumps(line) + "\n")


async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while await answer(reader, writer):
            await writer.drain()
    except (ConnectionError, asyncio.IncompleteReadError):
        pass
    finally:
        writer.close()


async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
    """Answer a request as the script says, and whether the connection stays open."""
    start, *lines = (await reader.readuntil(b"\r\n\r\n")).decode().splitlines()
    headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines if line)}
    body = json.loads(await reader.readexactly(int(headers.get("content-length", 0))) or b"{}")
    _, name, what = start.split()[1].split("/", 2)
    if what == "script":
        channels[name] = {**body, "count": 0}
        send(writer, {"sends": "{}"})
        return True
    assert what == "v1/chat/completions", what
    script = channels[name]
    index, script["count"] = script["count"], script["count"] + 1
    call = headers.get("x-client-request-id", "")
    fault = next((f for first, last, f in script.get("faults", []) if first <= index <= last), None)
    port = writer.get_extra_info("peername")[1]
    log(script, {"call": call, "fault": fault, "headers": headers, "body": body, "port": port})
    try:
        await asyncio.sleep(3600 if fault == "hang" else script.get("latency", 0))
        if fault == "cut_body":
            writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n\r\n{")
            await writer.drain()
        if isinstance(fault, str):
            return False
        done = completion(script, body)
        send(writer, fault or (streamed(done) if body.get("stream") else {"sends": json.dumps(done)}))
        return True
    finally:
        log(script, {"over": call})


def completion(script: dict, body: dict) -> dict:
    """What the pilot of the script says to a request."""
    texts = [message["content"] for message in body["messages"]]
    prompt = next(text for text in reversed(texts) if "Position:" in text)
    pilot = script.get("repair", script["pilot"]) if texts[-1] != prompt else script["pilot"]
    message = {"role": "assistant", "content": reply(pilot, prompt), **script.get("message", {})}
    in_json = json.dumps({"direction": message["content"]})
    if body.get("tools"):
        function = {"name": body["tools"][0]["function"]["name"], "arguments": in_json}
        message |= {"content": None, "tool_calls": [{"id": "1", "type": "function", "function": function}]}
    elif body.get("response_format"):
        message["content"] = in_json
    usage = None if script.get("no_usage") else {"prompt_tokens": 100, "completion_tokens": 2, "total_tokens": 102}
    choice = {"index": 0, "message": message, "finish_reason": script.get("finish_reason", "stop")}
    common = {"id": "x", "object": "chat.completion", "created": 0, "model": body["model"]}
    return {**common, "choices": [choice], "usage": usage}


def streamed(done: dict) -> dict:
    """The response with a completion as a stream of one chunk."""
    choices = [{**choice, "delta": choice["message"]} for choice in done["choices"]]
    chunk = json.dumps({**done, "object": "chat.completion.chunk", "choices": choices})
    return {"sends": f"data: {chunk}\n\ndata: [DONE]\n\n", "headers": {"Content-Type": "text/event-stream"}}


def send(writer: asyncio.StreamWriter, response: dict) -> None:
    """Send a response of `status`, `headers`, and either `sends`, its text, or the `message` of an error."""
    status = response.get("status", 200)
    error = {"error": {"message": response.get("message", f"scripted {status}"), "type": "scripted"}}
    data = (response.get("sends") or json.dumps(error)).encode()
    headers = {"Content-Type": "application/json", "Content-Length": len(data), **response.get("headers", {})}
    lines = [f"HTTP/1.1 {status} Scripted", *(f"{name}: {value}" for name, value in headers.items()), "", ""]
    writer.write("\r\n".join(lines).encode() + data)


async def main(port: str) -> None:
    async with await asyncio.start_server(serve, "127.0.0.1", int(port), limit=1 << 26, backlog=4096) as running:
        await running.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
