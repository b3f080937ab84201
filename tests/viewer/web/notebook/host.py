"""Shows the widgets of a notebook in a page, as JupyterLab does, and passes their messages to the kernel."""

from __future__ import annotations

import base64
import time
from typing import Any

import nbformat
from jupyter_client.blocking import BlockingKernelClient
from jupyter_client.connect import KernelConnectionInfo

from tests.viewer.web.page import PlayerPage

WIDGET_VIEW = "application/vnd.jupyter.widget-view+json"
WIDGET_STATE = "application/vnd.jupyter.widget-state+json"
SECONDS = 60
"""Time limit of each answer of the kernel. The limit is long, because machines that run tests may be busy."""
SHOW = """async ({state, buffers}) => {
    const bytes = (text) => new DataView(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
    for (const {path, data} of buffers) state[path[0]] = bytes(data);
    const listeners = new Map();
    const model = {
        get: (name) => state[name],
        set: (name, value) => {
            state[name] = value;
            for (const listener of listeners.get(`change:${name}`) ?? []) listener();
        },
        on: (name, listener) => listeners.set(name, [...(listeners.get(name) ?? []), listener]),
        off: (name, listener) => listeners.set(name, (listeners.get(name) ?? []).filter((each) => each !== listener)),
        send: async (content) => {
            const reply = await window.toKernel(content);
            if (!reply) return;
            window.bytesReceived = (window.bytesReceived ?? 0) + (reply.buffers[0]?.length ?? 0) * 0.75;
            for (const each of listeners.get("msg:custom") ?? []) each(reply.content, reply.buffers.map(bytes));
        },
    };
    const code = URL.createObjectURL(new Blob([state._esm], {type: "text/javascript"}));
    const {default: widget} = await import(code);
    window.model = model;
    window.listeners = listeners;
    window.removeWidget = await widget.render({model, el: document.querySelector(".output")});
}"""


class Kernel:
    """A connection to a running kernel, beside that of the program that executes the notebook."""

    def __init__(self, connection: KernelConnectionInfo) -> None:
        self._client = BlockingKernelClient()
        self._client.load_connection_info(connection)
        self._client.start_channels()
        self._client.wait_for_ready(timeout=SECONDS)
        self.requests: list[Any] = []

    def ask(self, model_id: str, content: Any) -> dict[str, Any]:
        """Send a message of a widget's page to the widget, and return the widget's answer."""
        self.requests.append(content)
        data = {"method": "custom", "content": content}
        message = self._client.session.msg("comm_msg", {"comm_id": model_id, "data": data})
        self._client.shell_channel.send(message)
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            answer = self._client.get_iopub_msg(timeout=SECONDS)
            data = answer["content"].get("data", {})
            if answer["msg_type"] == "comm_msg" and data.get("content", {}).get("id") == content["id"]:
                buffers = [base64.b64encode(bytes(each)).decode("ascii") for each in answer["buffers"]]
                return {"content": data["content"], "buffers": buffers}
        raise TimeoutError(f"no answer to {content}")

    def close(self) -> None:
        self._client.stop_channels()


def show_widget(page: PlayerPage, notebook: nbformat.NotebookNode, kernel: Kernel | None) -> None:
    """Show the last widget of an executed notebook in the page. Without a kernel, its messages are not answered."""
    model_id = widget_views(notebook)[-1]["model_id"]
    saved = notebook.metadata.widgets[WIDGET_STATE]["state"][model_id]
    page.page.expose_function("toKernel", lambda content: None if kernel is None else kernel.ask(model_id, content))
    page.page.evaluate(SHOW, {"state": saved["state"], "buffers": saved.get("buffers", [])})


def widget_views(notebook: nbformat.NotebookNode) -> list[Any]:
    """The views of widgets in the outputs of the cells."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return [output.data[WIDGET_VIEW] for output in outputs if WIDGET_VIEW in output.get("data", {})]
