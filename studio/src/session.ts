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
  /** Another scene is shown, or the one before goes on after a question that was refused. */
  scene(): void;
}

export class Session {
  private readonly socket: Socket;
  private decoding = false;
  private next: { blob: Blob; head: PanoramaHead } | null = null;
  private epoch = 0;
  // Numbers of questions: no other page's, whose questions a live source answers, too.
  private number = Math.floor(Math.random() * 2 ** 40) * 1024;
  private awaited = 0; // the number of the question that is not answered yet
  asked = { query: "", perception: "" };
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

  open(request: { view: string; query?: string; perception?: string } & Record<string, unknown>): void {
    this.active = true;
    this.epoch++;
    this.asked = { query: request.query ?? "", perception: request.perception ?? "" };
    // A live source that is only watched answers what others have asked.
    const asks = request.view !== "live" || this.asked.query !== "";
    if (!asks) this.answered();
    this.socket.open({ type: "open", ...request, ...(asks ? { question: this.question() } : {}) });
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
    return this.socket.send({ type: "query", text: query, perception, question });
  }

  retry(): void {
    this.socket.retry();
  }

  close(): void {
    this.active = false;
    this.epoch++;
    this.next = null;
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

  private message({ message, blobs, types }: Decoded): void {
    if (!this.active) return;
    const told = message as Message;
    if (told.type === "scene") {
      this.store.begin(told);
      if (told.question === this.awaited) this.answered();
      if (!this.awaited) this.asked = { query: told.query, perception: told.perception ?? "" };
      this.events.scene();
    } else if (told.type === "problem") {
      if (this.refused(told)) this.events.problem(told);
    } else if (told.type === "status") this.events.status(told.words);
    else if (told.type === "step") {
      const step = told as Step;
      if (step.question !== this.store.scene?.question) return; // it answers another question
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
