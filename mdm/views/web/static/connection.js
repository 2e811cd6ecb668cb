// The socket. A frame is drawn before the next one is asked for, so that one is in flight; a sleeping page asks for none.

export class Connection {
  // Args: told: gets each message; changed: gets "open", "lost" or "refused".
  constructor(told, changed) {
    this.told = told;
    this.changed = changed;
    this.wait = 500;
    this.opened = false;
    this.open();
  }

  open() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
    this.socket = socket;
    socket.onopen = () => { this.wait = 500; this.opened = true; this.changed("open", ""); };
    socket.onmessage = (event) => this.told(JSON.parse(event.data));
    socket.onclose = (event) => {
      this.changed(event.code === 1008 ? "refused" : "lost", event.reason);
      setTimeout(() => this.open(), this.wait);
      this.wait = Math.min(2 * this.wait, 5000);
    };
  }

  say(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
