
(async () => {
  const { default: widget } = await import(location.href + "explore.js");
  const listeners = new Set();
  const model = {
    on: (name, listener) => listeners.add(listener),
    off: (name, listener) => listeners.delete(listener),
    send: async ({ id, ...asked }) => {
      const body = JSON.stringify(asked), headers = { "Content-Type": "application/json" };
      const reply = await fetch("call", { method: "POST", headers, body }), found = await reply.json();
      for (const listener of listeners) {
        listener({ id: "of another place", found: {} });
        listener(reply.ok ? { id, found } : { id, error: found.error });
      }
    },
  };
  const el = document.body.appendChild(document.createElement("div"));
  window.leave = await widget.render({ model, el });
  window.tell = (view) => listeners.forEach((listener) => listener({ view }));
  window.shown = el.firstChild;
  window.listeners = listeners;
})()
