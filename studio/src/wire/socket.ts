/** The connection to the server: it comes back by itself, and never piles up messages. */

import { decode, type Decoded } from "./decode";
import type { Step } from "./messages";

export type Connection = "connecting" | "open" | "lost";

export interface SocketEvents {
  message(decoded: Decoded): void;
  connection(state: Connection, seconds: number): void;
}

const WAITS = [0.5, 1, 2, 4, 8];

export class Socket {
  private socket: WebSocket | null = null;
  private failures = 0;
  private timer = 0;
  private opening: object | null = null;
  private waiting: Decoded[] = [];
  private scheduled = false;

  constructor(private readonly address: string, private readonly events: SocketEvents) {}

  /** Ask for a session; it is asked for again after each reconnection. */
  open(request: object): void {
    this.opening = request;
    this.waiting = [];
    if (this.socket?.readyState === WebSocket.OPEN) this.send(request);
    else this.connect();
  }

  /** Change the session that is asked for after a reconnection. */
  amend(change: object): void {
    if (this.opening) this.opening = { ...this.opening, ...change };
  }

  /** Returns whether the message could be sent. */
  send(message: object): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** End the session, and stay away. */
  close(): void {
    this.opening = null;
    clearTimeout(this.timer);
    this.waiting = [];
    const socket = this.socket;
    this.socket = null;
    socket?.close();
  }

  retry(): void {
    clearTimeout(this.timer);
    if (this.socket === null && this.opening) this.connect();
  }

  private connect(): void {
    if (this.socket) return;
    clearTimeout(this.timer);
    this.events.connection("connecting", 0);
    const socket = new WebSocket(this.address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => {
      this.failures = 0;
      this.events.connection("open", 0);
      if (this.opening) this.send(this.opening);
    };
    socket.onmessage = ({ data }) => {
      if (this.socket === socket && data instanceof ArrayBuffer) this.take(decode(data));
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      const wait = WAITS[Math.min(this.failures++, WAITS.length - 1)];
      this.events.connection("lost", wait);
      this.timer = window.setTimeout(() => this.connect(), 1000 * wait);
    };
  }

  /** Messages that come faster than they are handled become one: the newest words, the newest of each blob. */
  private take(decoded: Decoded): void {
    const last = this.waiting.at(-1);
    if (last?.message.type === "step" && decoded.message.type === "step") {
      this.waiting[this.waiting.length - 1] = merged(last, decoded);
    } else this.waiting.push(decoded);
    if (this.scheduled) return;
    this.scheduled = true;
    setTimeout(() => {
      this.scheduled = false;
      const waiting = this.waiting;
      this.waiting = [];
      for (const one of waiting) this.events.message(one);
    }, 0);
  }
}

/** The newer step, with what only the older one brought along. */
export function merged(older: Decoded, newer: Decoded): Decoded {
  const [before, after] = [older.message as unknown as Step, newer.message as unknown as Step];
  const message = { ...newer.message } as unknown as Step;
  const [blobs, types] = [{ ...newer.blobs }, { ...newer.types }];
  for (const name of ["panorama", "belief", "evidence"] as const) {
    if (blobs[name] || !older.blobs[name] || after[name] === null) continue;
    (message as unknown as Record<string, unknown>)[name] = before[name];
    [blobs[name], types[name]] = [older.blobs[name], older.types[name]];
  }
  return { message: message as unknown as Decoded["message"], blobs, types };
}
