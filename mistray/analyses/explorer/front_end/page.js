// The local page: calls go to the server that has sent it.
import { mount } from "./explore.js";

async function call(name, given = {}) {
  const body = JSON.stringify({ call: name, given });
  const reply = await fetch("call", { method: "POST", headers: { "Content-Type": "application/json" }, body });
  const found = await reply.json();
  if (!reply.ok) throw new Error(found.error);
  return found;
}
async function follow(onView, onEnd, since) {
  try {
    for (let version = since; ;) {
      const view = await call("wait", { since: version });
      if (view.version > version) onView(view);
      version = view.version;
    }
  } catch {
    onEnd();
  }
}

mount(document.getElementById("explorer"), { call, follow }).catch((error) => {
  document.getElementById("explorer").textContent = `The explorer does not answer: ${error.message}`;
});
