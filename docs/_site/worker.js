// The search runs in a worker, which browsers refuse to pages that are read from a disk: there, a hidden frame is one.
(function () {
  "use strict";
  if (location.protocol !== "file:") return;
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.appendChild(frame);
      const inside = frame.contentWindow;
      inside.document.open();
      inside.document.write("<script>postMessage = (data) => parent.dispatchEvent(new MessageEvent('worker', { data }));"
        + "</script><script src='" + url + "'></script>");
      inside.document.close();
      this.ready = new Promise((resolve) => { inside.onload = resolve; }); // opening has removed all listeners
      this.inside = inside;
      window.addEventListener("worker", (event) => {
        const message = new MessageEvent("message", { data: event.data });
        this.dispatchEvent(message);
        if (this.onmessage) this.onmessage(message);
      });
    }
    postMessage(data) {
      this.ready.then(() => this.inside.dispatchEvent(new MessageEvent("message", { data })));
    }
    terminate() {}
  };
})();
