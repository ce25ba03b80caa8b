
(async (name, value) => {
  const root = document.querySelector(".mistray-explorer"), input = root.querySelector(`[name="${name}"]`);
  const began = performance.now();
  const drawn = new Promise((done) => {
    const watch = new MutationObserver(() => { watch.disconnect(); done(); });
    watch.observe(root, { attributes: true, attributeFilter: ["data-answers"] });
  });
  input.value = value;
  input.dispatchEvent(new Event(input.tagName === "SELECT" ? "change" : "input"));
  await drawn;
  return performance.now() - began;
})(%s, %s)
