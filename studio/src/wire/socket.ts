/** The connection to the server: it comes back by itself, and never piles up messages. */

import type { Blobs, Message, Step } from "./messages";

export type Connection = "connecting" | "open" | "lost";

export interface Decoded {
  message: Message;
  blobs: Blobs;
}

export interface SocketEvents {
  message(decoded: Decoded): void;
  connection(state: Connection, seconds: number): void;
}

const WAITS = [0.5, 1, 2, 4, 8];

/** A binary message: length, JSON, blobs. Throws if its parts do not add up. */
export function decode(data: ArrayBuffer): Decoded {
  const length = new DataView(data).getUint32(0, true);
  const message = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const blobs: Blobs = {};
  let at = 4 + length;
  for (const { name, bytes } of message.blobs) blobs[name] = data.slice(at, (at += bytes));
  if (at !== data.byteLength) throw new Error(`a message of ${data.byteLength} bytes; wanted ${at}`);
  return { message, blobs };
}

export class Socket {
  private socket: WebSocket | null = null;
  private failures = 0;
  private timer = 0;
  private opening: object | null = null;
  private waiting: Decoded[] = [];
  private scheduled = false;

  constructor(private readonly address: string, private readonly events: SocketEvents) {}

  /** Ask for a source; it is asked for again after each reconnection. */
  open(request: object): void {
    this.opening = request;
    this.waiting = [];
    if (!this.send(request)) this.connect();
  }

  /** Change what is asked for after a reconnection. */
  amend(change: object): void {
    if (this.opening) this.opening = { ...this.opening, ...change };
  }

  /** Returns whether the message could be sent. */
  send(message: object): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Stay away. */
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
    if (this.opening) this.connect();
  }

  private connect(): void {
    if (this.socket) return;
    clearTimeout(this.timer);
    this.events.connection("connecting", 0);
    const socket = (this.socket = new WebSocket(this.address));
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this.failures = 0;
      this.events.connection("open", 0);
      if (this.opening) this.send(this.opening);
    };
    socket.onmessage = ({ data }) => { if (this.socket === socket) this.take(decode(data)); };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.socket = null;
      const wait = WAITS[Math.min(this.failures++, WAITS.length - 1)];
      this.events.connection("lost", wait);
      this.timer = window.setTimeout(() => this.connect(), 1000 * wait);
    };
  }

  /** Steps that come faster than they are handled become one: the newest words, the newest of each picture. */
  private take(decoded: Decoded): void {
    const last = this.waiting.at(-1);
    if (last?.message.type === "step" && decoded.message.type === "step") this.waiting.splice(-1, 1, merged(last, decoded));
    else this.waiting.push(decoded);
    if (this.scheduled) return;
    this.scheduled = true;
    setTimeout(() => {
      this.scheduled = false;
      for (const one of this.waiting.splice(0)) this.events.message(one);
    }, 0);
  }
}

/** The newer step, with what only the older one brought along. */
export function merged(older: Decoded, newer: Decoded): Decoded {
  const carried: Partial<Step> = {};
  const { panorama, belief } = older.message as unknown as Step;
  if (panorama) carried.panorama = panorama;
  if (belief !== undefined) carried.belief = belief;
  const blobs = { ...older.blobs, ...newer.blobs };
  if ((newer.message as unknown as Step).belief === null) delete blobs.belief;
  return { message: { ...carried, ...newer.message }, blobs };
}
