"""Evaluate a language model with `drone-env infer`: score beside the optimum, moves, calls, all in a run folder.

    pip install -e '.[llm]'
    python examples/llm_evaluation.py                                                 # a scripted model, no network
    python examples/llm_evaluation.py --base-url http://127.0.0.1:8080/v1 --model my-model --maps 100

Measured: score 0.9773, optimum of the same 20 maps 0.9773; 149 requests, 121 answers usable at once, 14 after the
repair prompt. 3 seconds of CPU time.

Without `--base-url` the endpoint is the one below: an OpenAI-compatible server of thirty lines that reads the prompt,
as any model does, and flies to the first parcel that it names. It answers every tenth call with prose, so that the
report has something to count: an answer that cannot be used is asked for again.
"""

import argparse
import contextlib
import io
import json
import re
import tempfile
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import count
from pathlib import Path

from drone_env.cli import main

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
parser.add_argument("--base-url", help="an OpenAI-compatible endpoint; a scripted one is started if none is named")
parser.add_argument("--model", default="scripted")
parser.add_argument("--task", default="easy")
parser.add_argument("--maps", type=int, default=20, help="test maps to fly (%(default)s)")
args = parser.parse_args()


class ScriptedModel(BaseHTTPRequestHandler):
    """`POST /v1/chat/completions`, for prompts of the kind `coordinates`."""

    calls = count(1)

    def do_POST(self):
        """Answer with one action."""
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        prompt = next(m["content"] for m in reversed(body["messages"]) if "Position:" in m["content"])
        answer = self.choose(prompt) if next(self.calls) % 10 else "I would rather talk about the weather."
        choice = {"index": 0, "finish_reason": "stop", "message": {"role": "assistant", "content": answer}}
        tokens = sum(len(message["content"]) for message in body["messages"]) // 4
        usage = {"prompt_tokens": tokens, "completion_tokens": 1, "total_tokens": tokens + 1}
        reply = {"id": "1", "object": "chat.completion", "created": 0, "model": body["model"]}
        data = json.dumps({**reply, "choices": [choice], "usage": usage}).encode()
        self.send_response(200)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    @staticmethod
    def choose(prompt):
        """The way to the first parcel that the prompt names, along the row first."""
        place = re.compile(r"\((\d+), (\d+)\)")
        x, y = map(int, place.search(prompt, prompt.index("Position:")).groups())
        to_x, to_y = map(int, place.search(prompt, prompt.index("Parcels to deliver:")).groups())
        if x != to_x:
            return "RIGHT" if to_x > x else "LEFT"
        return "DOWN" if to_y > y else "UP"

    def log_message(self, *_):
        """Keep quiet."""


url = args.base_url
if url is None:
    server = ThreadingHTTPServer(("127.0.0.1", 0), ScriptedModel)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.server_port}/v1"

folder = Path(tempfile.mkdtemp(prefix="llm-evaluation-")) / "run"
options = ["--task", args.task, "--episodes", str(args.maps), "--prompt", "coordinates", "--out", str(folder)]
# Its standard output is the log of all flights; here only the figures are of interest.
with contextlib.redirect_stdout(io.StringIO()):
    status = main(["infer", "--base-url", url, "--model", args.model, *options])
if status:
    raise SystemExit(status)
report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
print(f"verdict {report['verdict']}: {report['flights']['flown']} flights, {report['calls']['requests']} requests")
print(f"turns: { ({name: n for name, n in report['turns'].items() if n}) }")
print(f"score {report['score']:.4f}, optimum of the same {args.maps} maps {report['baselines']['optimal']:.4f}")
print(f"the whole report: {folder / 'report.json'}")
