// The socket to the session: commands with answers, and frames as typed arrays. See frames.py for their layout.

const STATE = 1, PATCH = 2, LOOPS = 3, MAP = 4;
const RASTERS = ["height", "control"];

export class Link extends EventTarget {
  constructor() {
    super();
    this.number = 0;
    this.waiting = new Map();
    this.retry = 500;
    this.connect();
  }

  connect() {
    const scheme = location.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new WebSocket(`${scheme}//${location.host}/live`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.retry = 500; this.tell("open", {}); };
    this.socket.onmessage = (message) => {
      if (typeof message.data === "string") this.receiveText(JSON.parse(message.data));
      else this.receiveFrame(message.data);
    };
    this.socket.onclose = () => {
      for (const { reject } of this.waiting.values()) reject(new Error("the connection was lost"));
      this.waiting.clear();
      this.tell("closed", {});
      setTimeout(() => this.connect(), this.retry);
      this.retry = Math.min(8000, this.retry * 2);
    };
  }

  tell(type, detail) { this.dispatchEvent(new CustomEvent(type, { detail })); }

  /** Ask for something; resolves with the answer, rejects with what the session says against it. */
  ask(what, rest = {}) {
    return new Promise((resolve, reject) => {
      if (this.socket.readyState !== WebSocket.OPEN) { reject(new Error("not connected")); return; }
      const number = ++this.number;
      this.waiting.set(number, { resolve, reject });
      this.socket.send(JSON.stringify({ number, do: what, ...rest }));
    });
  }

  receiveText(told) {
    if (told.type === "answer") {
      const asked = this.waiting.get(told.number);
      this.waiting.delete(told.number);
      if (asked && told.error) asked.reject(new Error(told.error));
      else if (asked) asked.resolve(told);
      return;
    }
    this.tell(told.type, told);
  }

  receiveFrame(buffer) {
    const head = new DataView(buffer);
    const kind = head.getUint32(0, true);
    if (kind === STATE) {
      const state = decodeState(buffer, head);
      this.tell(state.earlier ? "earlier" : "state", state);
      if (!state.earlier && this.socket.readyState === WebSocket.OPEN) this.socket.send(`{"ack":${state.sequence}}`);
    } else if (kind === PATCH) {
      const [raster, row, column, rows, columns] = [4, 8, 12, 16, 20].map((at) => head.getUint32(at, true));
      this.tell("patch", { raster: RASTERS[raster], row, column, rows, columns, values: new Float32Array(buffer, 32) });
    } else if (kind === LOOPS) {
      const [mode, count, points] = [4, 8, 12].map((at) => head.getUint32(at, true));
      let at = 16;
      const width = new Float32Array(buffer, at, count); at += 4 * count;
      const time = new Float32Array(buffer, at, count); at += 4 * count;
      const start = new Uint32Array(buffer, at, count + 1); at += 4 * (count + 1);
      this.tell("loops", { mode, count, width, time, start, xy: new Float32Array(buffer, at, 2 * points) });
    } else if (kind === MAP) {
      const [west, north, cell, low, high] = [16, 24, 32, 40, 48].map((at) => head.getFloat64(at, true));
      const name = new TextDecoder().decode(new Uint8Array(buffer, 56, 16)).replace(/\0+$/, "");
      this.tell("mapcells", { name, rows: head.getUint32(4, true), columns: head.getUint32(8, true), west, north, cell, low, high, values: new Uint8Array(buffer, 72) });
    }
  }
}

export function decodeState(buffer, head = new DataView(buffer)) {
  const [sequence, edits, flags, channels, points, step] = [4, 8, 12, 16, 20, 24].map((at) => head.getUint32(at, true));
  let at = 48;
  const id = new Float64Array(buffer, at, channels); at += 8 * channels;
  const size = new Float32Array(buffer, at, 4 * channels); at += 16 * channels;
  const start = new Uint32Array(buffer, at, channels + 1); at += 4 * (channels + 1);
  const xy = new Float32Array(buffer, at, 2 * points); at += 8 * points;
  // Where widths vary along the channels: in steps of the greatest one.
  const steps = flags & 4 ? new Uint16Array(buffer, at, points) : null, fine = head.getFloat32(28, true) / 65535;
  return {
    sequence, edits, playing: (flags & 1) !== 0, earlier: (flags & 2) !== 0, channels, points, step,
    time: head.getFloat64(32, true), stepMs: head.getFloat64(40, true),
    id, size, start, xy, width: (c, i) => (steps ? steps[i] * fine : size[4 * c]),
  };
}
