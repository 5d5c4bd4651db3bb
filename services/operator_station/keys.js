// Runs in the view, within the operator's page: sends STOP keys to the page, and holds the walking pad.
// `valorPad(buttons, walks)`, called by the station: names and ids of the pad's buttons, null if this viewer has none.
(() => {
  const pages = ["127.0.0.1", "localhost", "[::1]"].map((host) => `http://${host}:${location.port - 1}`);
  const post = (text) => { if (parent !== window) parent.postMessage(text, "*") };  // no other page can be the parent
  setInterval(() => post("hello"), 1000);
  post("hello");
  // Browsers may deny storage to a frame of another site: the page keeps the operator's secret, and names the frame so.
  if (parent !== window) Object.defineProperty(window, "localStorage", { value: {
    getItem: (key) => key.endsWith("valor_operator") && window.name || null,
    setItem: (key, value) => { if (key.endsWith("valor_operator")) post({ operator: window.name = value }) },
  } });

  const KEYS = { KeyQ: "turn left", KeyE: "turn right", KeyW: "forward", KeyS: "back", KeyA: "left", KeyD: "right",
                 ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "turn left", ArrowRight: "turn right" };
  const SIGNS = { "turn left": "↺ Q", forward: "↑ W", "turn right": "↻ E", left: "← A", back: "↓ S", right: "→ D" };
  const PERIOD = 100;  // of a held button [ms]
  let buttons = null, walks = false, held = null, timer = null, drawn = null;

  const send = () => window.__viserMutable.sendMessage(
    { type: "GuiButtonHoldMessage", uuid: buttons[held], frequency: 1000 / PERIOD });
  function release(name = held) {
    if (name !== held) return;
    clearInterval(timer);
    held = null;
  }
  function hold(name) {
    if (!buttons || !walks || held === name) return;
    release();
    held = name;
    send();
    timer = setInterval(send, PERIOD);
  }
  // On a phone, viser's controls take the lower part: here in full width, with the pad above them.
  const style = document.documentElement.appendChild(document.createElement("style"));
  style.textContent = `
    #pad { position: fixed; left: 50%; bottom: 10px; transform: translateX(-50%); display: grid; gap: 6px; z-index: 5;
           grid-template-columns: repeat(3, 72px); touch-action: none; user-select: none }
    #pad button { height: 52px; border: 1px solid #777; border-radius: 8px; background: #fffd; font: 18px system-ui }
    #pad button:active { background: #bcd }
    @media (max-width: 36em) {
      #pad { bottom: calc(45% + 8px) }
      [style*="width: 20em"] { width: 100% !important; max-height: 45% !important }
      [style*="width: 20em"] [style*="width: 20em"] { max-height: none !important }
    }`;
  window.valorPad = (ids, walking) => {
    release();
    [buttons, walks] = [ids, walking];
    if (drawn) drawn.remove();
    drawn = ids && walking ? document.body.appendChild(document.createElement("div")) : null;
    if (!drawn) return;
    drawn.id = "pad";
    for (const name in SIGNS) {
      const button = drawn.appendChild(document.createElement("button"));
      button.textContent = SIGNS[name];
      button.title = button.ariaLabel = name;
      button.addEventListener("pointerdown", (event) => {
        event.preventDefault();
        button.setPointerCapture(event.pointerId);
        hold(name);
      });
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"])
        button.addEventListener(end, () => release(name));
    }
  };

  const WRITES = "textarea, [contenteditable=true], input:not([type=checkbox]):not([type=radio]):not([type=button])";
  addEventListener("keydown", (event) => {
    const writes = event.target.matches?.(WRITES);
    if (event.code === "Escape" || (event.code === "Space" && !writes)) {
      event.preventDefault();
      event.stopImmediatePropagation();
      if (!event.repeat) post("stop");
    } else if (buttons && walks && !writes && event.code in KEYS && !event.ctrlKey && !event.altKey && !event.metaKey) {
      event.preventDefault();
      event.stopImmediatePropagation();
      hold(KEYS[event.code]);
    }
  }, true);
  addEventListener("keyup", (event) => {
    if (event.code === "Space" && !event.target.matches?.(WRITES)) event.preventDefault();
    if (event.code in KEYS) release(KEYS[event.code]);
  }, true);
  addEventListener("blur", () => release());
  document.addEventListener("visibilitychange", () => release());
  addEventListener("message", ({ origin, source, data }) => {
    if (!pages.includes(origin) || source !== parent) return;
    if (data.down in KEYS) hold(KEYS[data.down]);
    else if (data.up) release(data.up === "all" ? held : KEYS[data.up]);
  });
})();
