// The web socket to the server: what it says, and what is said to it.
export class Link extends EventTarget {
  constructor() {
    super();
    this.you = { source: "", role: "operator" };
    this.count = 0;
    this.seen = 0; // number of the newest snapshot
    this.open();
  }

  open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(`${scheme}://${location.host}/link`);
    this.socket.onmessage = (event) => {
      const { say, is } = JSON.parse(event.data);
      if (say === "you") this.you = is;
      if (say === "snapshot") this.send({ say: "seen", n: this.seen = is.number });
      this.dispatchEvent(new CustomEvent(say, { detail: is }));
    };
    this.socket.onclose = () => {
      this.dispatchEvent(new CustomEvent("gone"));
      setTimeout(() => this.open(), 1000);
    };
  }

  get ready() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(words) {
    // what a slow network holds back is not sent later: it would be wanted no more; a stop always is
    if (this.ready && (words.kind === "stop" || this.socket.bufferedAmount < 20000)) this.socket.send(JSON.stringify(words));
  }

  ask(kind, rest = {}) {
    const id = String(++this.count);
    this.send({ say: "ask", seen: this.seen, id, kind, ...rest });
    return id;
  }
}
