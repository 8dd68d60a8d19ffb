/** What is watched: what the server sends comes into the store, what a person does goes to the server. */

import type { Store } from "./store";
import { address } from "./wire/api";
import type { Problem } from "./wire/messages";
import { Socket, type Connection, type Decoded } from "./wire/socket";

export interface SessionEvents {
  connection(state: Connection, seconds: number): void;
  problem(problem: Problem): void;
  status(words: string): void;
  /** Another scene is shown, or the one before goes on after a question that was refused. */
  scene(): void;
}

export interface Request {
  source: string;
  query?: string;
  perception?: string;
  drive?: string;
  hfov?: number;
}

/** Decodes one picture at a time; of those that wait, only the newest is kept. */
class Decoder {
  private next: [Blob, (image: ImageBitmap) => void] | null = null;
  private busy = false;

  async take(data: ArrayBuffer, done: (image: ImageBitmap) => void): Promise<void> {
    this.next = [new Blob([data]), done];
    if (this.busy) return;
    this.busy = true;
    while (this.next) {
      const [blob, shown]: [Blob, (image: ImageBitmap) => void] = this.next;
      this.next = null;
      const image = await createImageBitmap(blob, { colorSpaceConversion: "none" }).catch(() => null);
      if (image) shown(image);
    }
    this.busy = false;
  }
}

export class Session {
  private readonly socket: Socket;
  private readonly decoders: Record<string, Decoder> = {};
  private epoch = 0;
  // Numbers of questions: no other page's, whose questions the same source may answer.
  private number = Math.floor(Math.random() * 2 ** 40) * 1024;
  private awaited = 0; // the number of the question that is not answered yet
  asked = { query: "", perception: "" };
  active = false;

  constructor(private readonly store: Store, private readonly events: SessionEvents) {
    const url = new URL(address("ws"), location.href);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    this.socket = new Socket(url.href, {
      message: (decoded) => this.message(decoded),
      connection: (state, seconds) => events.connection(state, seconds),
    });
  }

  open(request: Request): void {
    this.active = true;
    this.epoch++;
    this.asked = { query: request.query ?? "", perception: request.perception ?? "" };
    // Who only watches gets the answers to what others have asked.
    this.answered();
    this.socket.open({ type: "open", ...request, ...(this.asked.query ? { question: this.question() } : {}) });
  }

  /** The number of a new question; until it is answered or refused the page shows no answer. */
  private question(): number {
    this.store.wait(this.asked.query);
    return (this.awaited = ++this.number);
  }

  private answered(): void {
    this.awaited = 0;
    this.store.wait(null);
  }

  send(message: Record<string, unknown>): boolean {
    return this.socket.send(message);
  }

  /** Look for something else, or with another perception, also after a reconnection. Returns whether it could be sent. */
  ask(query: string, perception = this.asked.perception): boolean {
    this.asked = { query, perception };
    const question = this.question();
    this.socket.amend({ query, perception, question });
    return this.socket.send({ type: "ask", query, perception, question });
  }

  retry(): void {
    this.socket.retry();
  }

  close(): void {
    this.active = false;
    this.epoch++;
    this.answered();
    this.socket.close();
  }

  /** What a question is refused for: the one before goes on. Returns whether anybody still asks it. */
  private refused({ question, fatal }: Problem): boolean {
    if (fatal) this.answered();
    if (!question || fatal) return true;
    const { scene } = this.store;
    if (question !== this.awaited) return question === scene?.question && !this.awaited;
    this.answered();
    if (scene) {
      this.asked = { query: scene.query, perception: scene.perception ?? "" };
      this.socket.amend({ ...this.asked, question: scene.question });
      this.events.scene();
    }
    return true;
  }

  private message({ message, blobs }: Decoded): void {
    if (!this.active) return;
    const { store } = this;
    if (message.type === "scene") {
      store.begin(message);
      if (message.question === this.awaited) this.answered();
      if (!this.awaited) this.asked = { query: message.query, perception: message.perception ?? "" };
      this.events.scene();
    } else if (message.type === "problem") {
      if (this.refused(message)) this.events.problem(message);
    } else if (message.type === "status") this.events.status(message.words);
    else if (message.question === store.scene?.question) {
      store.show(message);
      const { panorama: head, belief } = message;
      this.picture(blobs, "panorama", (image) => head && store.picture(image, head));
      this.picture(blobs, "belief", (image) => belief && store.believe(belief, image));
      this.picture(blobs, "evidence", (image) => store.observe(image));
    } // else it answers another question
  }

  private picture(blobs: Decoded["blobs"], name: string, shown: (image: ImageBitmap) => void): void {
    const { epoch } = this;
    const { scene } = this.store;
    if (blobs[name]) void (this.decoders[name] ??= new Decoder()).take(blobs[name], (image) => {
      if (epoch === this.epoch && (name === "panorama" || scene === this.store.scene)) shown(image);
    });
  }
}
