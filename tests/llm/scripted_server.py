"""An OpenAI-compatible server that does as it is told: `python scripted_server.py PORT`.

`POST /NAME/script` opens an endpoint at `/NAME/v1`; its body holds `log` (a file), `pilot` (perfect, greedy, plan, able
for perfect or greedy by what the prompt tells, aloud for the same behind thoughts, or a text to answer with), `repair`
(the same, for repair prompts), `latency` in seconds, and `faults`: a list of [first, last, fault] by the number of the
request from 0, where the first that covers it holds. Each request is a line in the log before it is answered, and a
second line when that is over, however it was answered.
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
    if pilot == "aloud":
        return f"Not every ACTION: brings it nearer.\n**ACTION: {reply('able', prompt)}**"
    if pilot == "able":
        pilot = "perfect" if "Parcels to deliver:" in prompt else "greedy"
    if pilot == "perfect":
        return tour(prompt, number(prompt, r"(\d+) units"))[0].name
    if pilot == "plan":
        return json.dumps({"actions": [a.name for a in tour(prompt, number(prompt, r"Steps left: (\d+)"))]})
    if pilot == "greedy":
        return next(iter(route(points(prompt, "Position:")[0], points(prompt, "Target:")[0])), Action.WAIT).name
    return pilot


def text_of(content: str | list) -> str:
    """The text of a message, which may have a picture beside it."""
    return content if isinstance(content, str) else "".join(part.get("text", "") for part in content)


class Channel:
    """One scripted endpoint."""

    def __init__(self, script: dict) -> None:
        self._path = Path(script["log"])
        self.script = script
        self.count = 0

    def log(self, line: dict) -> None:
        with self._path.open("a") as file:
            file.write(json.dumps(line) + "\n")


class Server:
    def __init__(self) -> None:
        self.channels: dict[str, Channel] = {}

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while await self.answer(reader, writer):
                pass
        except (ConnectionError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        headers = {
            name.lower(): value.strip()
            for name, _, value in (line.partition(":") for line in head.splitlines()[1:] if line)
        }
        body = json.loads(await reader.readexactly(int(headers.get("content-length", 0))) or b"{}")
        _, name, what = head.split()[1].split("/", 2)
        if what == "script":
            self.channels[name] = Channel(body)
            self.send(writer, 200, "{}")
            return True
        assert what == "v1/chat/completions", what
        channel = self.channels[name]
        script = channel.script
        index, channel.count = channel.count, channel.count + 1
        call = headers.get("x-client-request-id", "")
        fault = next((f for first, last, f in script.get("faults", []) if first <= index <= last), None)
        port = writer.get_extra_info("peername")[1]
        line = {"call": call, "fault": fault, "headers": headers, "body": body, "port": port}
        channel.log(line)
        try:
            await asyncio.sleep(script.get("latency", 0))
            return await self.respond(writer, script, body, fault)
        finally:
            channel.log({"over": call})

    async def respond(self, writer: asyncio.StreamWriter, script: dict, body: dict, fault: object) -> bool:
        """Answer as the script says, and whether the connection stays open."""
        if fault == "hang":
            await asyncio.sleep(3600)
        if fault == "cut":
            return False
        if fault == "cut_body":
            writer.write(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n\r\n{")
            await writer.drain()
            return False
        if isinstance(fault, dict):
            error = {"error": {"message": fault.get("message", f"scripted {fault.get('status')}"), "type": "scripted"}}
            sent = fault.get("sends") or json.dumps(error)
            self.send(writer, fault.get("status", 200), sent, fault.get("headers", {}))
            return True
        texts = [text_of(message["content"]) for message in body["messages"]]
        prompt = next(text for text in reversed(texts) if "Position:" in text)
        pilot = script.get("repair", script["pilot"]) if texts[-1] != prompt else script["pilot"]
        message = {"role": "assistant", "content": reply(pilot, prompt), **script.get("message", {})}
        if body.get("tools"):
            function = body["tools"][0]["function"]["name"]
            arguments = json.dumps({"direction": message["content"]})
            message["tool_calls"] = [
                {"id": "1", "type": "function", "function": {"name": function, "arguments": arguments}}
            ]
            message["content"] = None
        elif body.get("response_format"):
            message["content"] = json.dumps({"direction": message["content"]})
        reason = script.get("finish_reason", "stop")
        usage = None if script.get("no_usage") else {"prompt_tokens": 100, "completion_tokens": 2, "total_tokens": 102}
        common = {"id": "x", "created": 0, "model": body["model"]}
        choice = {"index": 0, "message": message, "finish_reason": reason}
        sent = {**common, "object": "chat.completion", "choices": [choice], "usage": usage}
        self.send(writer, 200, json.dumps(sent))
        await writer.drain()
        return True

    def send(self, writer, status: int, text: str, headers: dict | None = None) -> None:
        data = text.encode()
        more = "".join(f"{name}: {value}\r\n" for name, value in (headers or {}).items())
        start = f"HTTP/1.1 {status} Scripted\r\nContent-Type: application/json\r\nContent-Length: {len(data)}\r\n{more}"
        writer.write(f"{start}\r\n".encode() + data)


async def main(port: str) -> None:
    server = Server()
    async with await asyncio.start_server(server.serve, "127.0.0.1", int(port), limit=1 << 26, backlog=4096) as running:
        await running.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
