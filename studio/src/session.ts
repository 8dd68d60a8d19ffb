/** A live session: what the server sends comes into the store, what a person does goes to the server. */

import type { Store } from "./store";
import { address } from "./wire/api";
import type { Decoded } from "./wire/decode";
import type { Message, PanoramaHead, Problem, Step } from "./wire/messages";
import { Socket, type Connection } from "./wire/socket";

export interface SessionEvents {
  connection(state: Connection, seconds: number): void;
  problem(problem: Problem): void;
  status(words: string): void;
  scene(): void;
}

export class Session {
  private readonly socket: Socket;
  private decoding = false;
  private next: { blob: Blob; head: PanoramaHead } | null = null;
  private epoch = 0;
  active = false;

  constructor(private readonly store: Store, private readonly events: SessionEvents) {
    const url = new URL(address("ws"), location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    url.hash = "";
    this.socket = new Socket(url.href, {
      message: (decoded) => this.message(decoded),
      connection: (state, seconds) => events.connection(state, seconds),
    });
  }

  open(request: Record<string, unknown>): void {
    this.active = true;
    this.epoch++;
    this.socket.open({ type: "open", ...request });
  }

  send(message: Record<string, unknown>): boolean {
    return this.socket.send(message);
  }

  /** Look for something else, also after a reconnection. Returns whether it could be sent. */
  ask(query: string): boolean {
    this.socket.amend({ query });
    return this.socket.send({ type: "query", text: query });
  }

  retry(): void {
    this.socket.retry();
  }

  close(): void {
    this.active = false;
    this.epoch++;
    this.next = null;
    this.socket.close();
  }

  private message({ message, blobs, types }: Decoded): void {
    if (!this.active) return;
    const told = message as Message;
    if (told.type === "scene") {
      this.store.begin(told);
      this.events.scene();
    } else if (told.type === "problem") this.events.problem(told);
    else if (told.type === "status") this.events.status(told.words);
    else if (told.type === "step") {
      const step = told as Step;
      this.store.show(step, blobs);
      if (blobs.panorama && step.panorama)
        this.picture(new Blob([blobs.panorama], { type: types.panorama }), step.panorama);
    }
  }

  /** Decodes one panorama at a time; of those that wait, only the newest is kept. */
  private picture(blob: Blob, head: PanoramaHead): void {
    this.next = { blob, head };
    if (!this.decoding) void this.decode();
  }

  private async decode(): Promise<void> {
    this.decoding = true;
    const { epoch } = this;
    while (this.next) {
      const { blob, head } = this.next;
      this.next = null;
      const image = await createImageBitmap(blob).catch(() => null);
      if (!image || epoch !== this.epoch) continue;
      const before = this.store.panorama?.image;
      this.store.panorama = { image, head };
      this.store.emit("panorama");
      if (before instanceof ImageBitmap) before.close();
    }
    this.decoding = false;
  }
}
