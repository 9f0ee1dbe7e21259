// Search from disk: browsers refuse workers on file:, so the worker's script runs in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      const frame = document.createElement("iframe");
      frame.hidden = true;
      document.body.append(frame);
      const page = frame.contentDocument;
      addEventListener("message", event => {
        if (event.source === frame.contentWindow)
          this.dispatchEvent(new MessageEvent("message", { data: event.data }));
      });
      this.ready = new Promise(resolve => (frame.contentWindow.begun = resolve));
      this.frame = frame.contentWindow;
      page.open();
      page.write(
        "<script>self.postMessage = data => parent.postMessage(data, '*');" +
          "self.importScripts = (...urls) => urls.reduce((before, url) => before.then(() =>" +
          "new Promise((done, failed) => { const script = document.createElement('script');" +
          "script.src = url; script.onload = done; script.onerror = failed;" +
          "document.head.append(script); })), Promise.resolve());" +
          `</scr` + `ipt><script src="${url}" onload="begun()"></scr` + `ipt>`
      );
      page.close();
    }
    postMessage(data) {
      this.ready.then(() => this.frame.dispatchEvent(new MessageEvent("message", { data })));
    }
    terminate() {}
  };
}
