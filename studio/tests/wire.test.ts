/** Messages of the server, and the connection that comes back by itself. */

import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { Session } from "../src/session";
import { Store } from "../src/store";
import { decode, merged, Socket, type Connection, type Decoded } from "../src/wire/socket";

function message(words: Record<string, unknown>, ...blobs: [string, Uint8Array][]): ArrayBuffer {
  const told = { ...words, blobs: blobs.map(([name, bytes]) => ({ name, bytes: bytes.length })) };
  const text = new TextEncoder().encode(JSON.stringify(told));
  const all = new Uint8Array(4 + text.length + blobs.reduce((sum, [, bytes]) => sum + bytes.length, 0));
  new DataView(all.buffer).setUint32(0, text.length, true);
  all.set(text, 4);
  let at = 4 + text.length;
  for (const [, bytes] of blobs) {
    all.set(bytes, at);
    at += bytes.length;
  }
  return all.buffer;
}

it("takes a message apart", () => {
  const { message: told, blobs } = decode(message({ type: "step", stamp: 2 }, ["belief", Uint8Array.of(1, 2)], ["panorama", Uint8Array.of(7)]));
  expect(told.type).toBe("step");
  expect([...new Uint8Array(blobs.belief)]).toEqual([1, 2]);
  expect([...new Uint8Array(blobs.panorama)]).toEqual([7]);
});

it("refuses a message whose parts do not add up", () => {
  const whole = message({ type: "step" }, ["belief", Uint8Array.of(4)]);
  expect(() => decode(whole.slice(0, -1))).toThrow("wanted");
});

it("merges steps that pile up: the newest words, the newest of each part", () => {
  const step = (number: number, more: Record<string, unknown>, ...blobs: [string, Uint8Array][]): Decoded =>
    decode(message({ type: "step", number, ...more }, ...blobs));
  const older = step(1, { belief: { border: [] }, panorama: { stamp: 1 } }, ["belief", Uint8Array.of(4)], ["panorama", Uint8Array.of(1)]);
  const newer = step(2, { panorama: { stamp: 2 } }, ["panorama", Uint8Array.of(2)]);
  const both = merged(older, newer);
  expect(both.message).toMatchObject({ number: 2, belief: { border: [] }, panorama: { stamp: 2 } });
  expect([...new Uint8Array(both.blobs.panorama)]).toEqual([2]);
  expect([...new Uint8Array(both.blobs.belief)]).toEqual([4]);
});

class FakeSocket {
  static readonly OPEN = 1;
  static made: FakeSocket[] = [];
  readyState = 0;
  sent: string[] = [];
  binaryType = "";
  onopen = () => {};
  onclose = () => {};
  onmessage = (_: { data: unknown }) => {};
  constructor(readonly address: string) {
    FakeSocket.made.push(this);
  }
  send(text: string): void {
    this.sent.push(text);
  }
  close(): void {
    this.readyState = 3;
  }
  opens(): void {
    this.readyState = 1;
    this.onopen();
  }
  breaks(): void {
    this.readyState = 3;
    this.onclose();
  }
}

beforeEach(() => {
  vi.useFakeTimers();
  FakeSocket.made = [];
  vi.stubGlobal("WebSocket", FakeSocket);
  vi.stubGlobal("window", globalThis);
});
afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

it("comes back by itself and asks again for what was open", () => {
  const states: [Connection, number][] = [];
  const socket = new Socket("ws://here/ws", { message: () => {}, connection: (...state) => states.push(state) });
  socket.open({ type: "open", view: "walk", query: "sofa" });
  FakeSocket.made[0].opens();
  socket.amend({ query: "chair" });
  FakeSocket.made[0].breaks();
  expect(states.at(-1)).toEqual(["lost", 0.5]);
  vi.advanceTimersByTime(500);
  expect(FakeSocket.made.length).toBe(2);
  FakeSocket.made[1].breaks();
  expect(states.at(-1)).toEqual(["lost", 1]);
  vi.advanceTimersByTime(1000);
  FakeSocket.made[2].opens();
  expect(states.at(-1)).toEqual(["open", 0]);
  expect(FakeSocket.made[2].sent).toEqual(['{"type":"open","view":"walk","query":"chair"}']);
  socket.close();
  FakeSocket.made[2].breaks();
  vi.advanceTimersByTime(60_000);
  expect(FakeSocket.made.length).toBe(3);
});

it("hands on one step where several have piled up", () => {
  const told: Decoded[] = [];
  const socket = new Socket("ws://here/ws", { message: (one) => told.push(one), connection: () => {} });
  socket.open({});
  FakeSocket.made[0].opens();
  for (const number of [1, 2, 3]) FakeSocket.made[0].onmessage({ data: message({ type: "step", number }) });
  vi.advanceTimersByTime(1);
  expect(told.map(({ message: one }) => (one as unknown as { number: number }).number)).toEqual([3]);
});

/** A session that has asked for a sofa, with the messages of its server. */
function asking() {
  vi.stubGlobal("location", { href: "http://here/", search: "" });
  const store = new Store();
  const problems: string[] = [];
  const session = new Session(store, {
    connection: () => {}, problem: ({ problem }) => problems.push(problem), status: () => {}, scene: () => {},
  });
  session.open({ source: "apartment:2", query: "sofa", perception: "scout" });
  const socket = FakeSocket.made[0];
  socket.opens();
  const says = (words: Record<string, unknown>) => {
    socket.onmessage({ data: message(words) });
    vi.advanceTimersByTime(1);
  };
  const asked = () => JSON.parse(socket.sent.at(-1)!) as { question: number; query: string; perception: string };
  const scene = (question: number, query: string) => says({ type: "scene", query, perception: "scout", question, methods: [] });
  const step = (question: number) =>
    says({ type: "step", question, world_R_camera: [1, 0, 0, 0, 1, 0, 0, 0, 1], estimate: { direction: [1, 0, 0] }, modes: [], look: { age: 0.1 } });
  return { store, session, problems, says, asked, scene, step };
}

it("shows no answer to another question", () => {
  const { store, session, asked, scene, step } = asking();
  const first = asked().question;
  expect(store.lookingFor).toBe("sofa");
  scene(first, "sofa");
  step(first);
  expect(store.direction).toEqual([1, 0, 0]);
  session.ask("bed");
  const second = asked().question;
  expect([store.direction, store.lookingFor]).toEqual([null, "bed"]);
  step(first); // was on its way
  expect(store.direction).toBeNull();
  session.ask("bed", "truth"); // before the bed was found
  expect(asked()).toMatchObject({ query: "bed", perception: "truth", question: second + 1 });
  scene(second, "bed");
  step(second);
  expect([store.direction, store.lookingFor]).toEqual([null, "bed"]);
  scene(second + 1, "bed");
  step(second); // of a merged or late message
  expect(store.direction).toBeNull();
  step(second + 1);
  expect(store.direction).toEqual([1, 0, 0]);
});

it("goes on with the answer before a question that is refused", () => {
  const { store, session, problems, says, asked, scene, step } = asking();
  const first = asked().question;
  scene(first, "sofa");
  step(first);
  session.ask("sfoa");
  says({ type: "problem", problem: "somebody else's", change: "", question: 5 });
  expect(problems).toEqual([]);
  says({ type: "problem", problem: "unknown", change: "", question: asked().question });
  expect(problems).toEqual(["unknown"]);
  expect([store.direction, store.lookingFor, session.asked.query]).toEqual([[1, 0, 0], null, "sofa"]);
});
