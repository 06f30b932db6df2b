"""A scripted OpenAI-compatible server: `python scripted_server.py PORT`.

`POST /NAME/script` opens an endpoint at `/NAME/v1`. Its body contains:
- `pilot`: perfect, greedy, plan, able (perfect or greedy, as the prompt allows), or a text to answer with.
- `latency`: seconds.
- `together`: a number of requests; the endpoint answers none until this many have come.
- `rejects`: the message of the 400 for each field, and for the role `system`, that a request may not contain.
- `faults`: a list of [first, last, fault] by the number of the request from 0; the first match applies.
"""

import itertools
import json
import re
import sys
import threading
import time
import traceback
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

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


scripts: dict[str, dict] = {}
"""The script of each endpoint, with the lines of its log (`log`), a counter of its requests (`numbers`), and a barrier
for the first ones (`meeting`)."""


def script(name: str, what: dict) -> list[dict]:
    """Open an endpoint, and return its log: one line for each request before it is answered, and one after that."""
    meeting = threading.Barrier(what.get("together", 1))
    scripts[name] = {**what, "log": [], "numbers": itertools.count(), "meeting": meeting}
    return scripts[name]["log"]


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    wbufsize = -1

    def do_POST(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers.get("content-length", 0))) or b"{}")
        _, name, what = self.path.split("/", 2)
        if what == "script":
            script(name, body)
            self.respond({"sends": "{}"})
            return
        assert what == "v1/chat/completions", what
        told = scripts[name]
        index, call = next(told["numbers"]), self.headers.get("x-client-request-id", "")
        fault = next((f for first, last, f in told.get("faults", []) if first <= index <= last), None)
        parts = {*body, body["messages"][0]["role"]}
        refused = next((message for part, message in told.get("rejects", {}).items() if part in parts), None)
        fault = fault or (refused and {"status": 400, "message": refused})
        headers = {name.lower(): value for name, value in self.headers.items()}
        told["log"].append({"call": call, "headers": headers, "body": body, "port": self.client_address[1]})
        try:
            if index < told["meeting"].parties:
                told["meeting"].wait()
            time.sleep(3600 if fault == "hang" else told.get("latency", 0))
            if isinstance(fault, str):
                self.close_connection = True
                if fault == "cut_body":
                    self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 5000\r\n\r\n{")
                return
            done = completion(told, body)
            self.respond(fault or (streamed(done) if body.get("stream") else {"sends": json.dumps(done)}))
        finally:
            told["log"].append({"over": call})

    def respond(self, response: dict) -> None:
        """Send a response of `status`, `headers`, and either `sends`, its text, or the `message` of an error."""
        status = response.get("status", 200)
        error = {"error": {"message": response.get("message", f"scripted {status}"), "type": "scripted"}}
        data = (response.get("sends") or json.dumps(error)).encode()
        self.send_response(status, "Scripted")
        headers = {"Content-Type": "application/json", "Content-Length": len(data), **response.get("headers", {})}
        for name, value in headers.items():
            self.send_header(name, str(value))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None: ...


class Server(ThreadingHTTPServer):
    request_queue_size = 4096

    def handle_error(self, *_: object) -> None:
        if not isinstance(sys.exc_info()[1], ConnectionError):  # of a client that was killed
            traceback.print_exc()


def completion(script: dict, body: dict) -> dict:
    """What the pilot of the script says to a request."""
    texts = [message["content"] for message in body["messages"]]
    prompt = next(text for text in reversed(texts) if "Position:" in text)
    message = {"role": "assistant", "content": reply(script["pilot"], prompt), **script.get("message", {})}
    in_json = json.dumps({"direction": message["content"]})
    if body.get("tools"):
        function = {"name": body["tools"][0]["function"]["name"], "arguments": in_json}
        message |= {"content": None, "tool_calls": [{"id": "1", "type": "function", "function": function}]}
    elif body.get("response_format"):
        message["content"] = in_json
    usage = {"prompt_tokens": 100, "completion_tokens": 2, "total_tokens": 102}
    choice = {"index": 0, "message": message, "finish_reason": script.get("finish_reason", "stop")}
    common = {"id": "x", "object": "chat.completion", "created": 0, "model": body["model"]}
    return {**common, "choices": [choice], "usage": usage}


def streamed(done: dict) -> dict:
    """The response with a completion as a stream of one chunk."""
    choices = [{**choice, "delta": choice["message"]} for choice in done["choices"]]
    chunk = json.dumps({**done, "object": "chat.completion.chunk", "choices": choices})
    return {"sends": f"data: {chunk}\n\ndata: [DONE]\n\n", "headers": {"Content-Type": "text/event-stream"}}


if __name__ == "__main__":
    Server(("127.0.0.1", int(sys.argv[1])), Handler).serve_forever()
