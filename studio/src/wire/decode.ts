/** Binary messages (length, JSON, blobs), and the base64 of stored episodes. */

import { termsOf, type Density } from "../math/density";
import type { BeliefHead, Blobs, Message } from "./messages";

export interface Decoded {
  message: Message;
  blobs: Blobs;
  types: Record<string, string>;
}

/** A message of the server; throws if its parts do not add up. */
export function decode(data: ArrayBuffer): Decoded {
  const length = new DataView(data).getUint32(0, true);
  const message = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const blobs: Blobs = {};
  const types: Record<string, string> = {};
  let at = 4 + length;
  for (const { name, type, bytes } of message.blobs ?? []) {
    blobs[name] = data.slice(at, (at += bytes));
    types[name] = type;
  }
  if (at !== data.byteLength) throw new Error(`a message of ${data.byteLength} bytes; wanted ${at}`);
  return { message, blobs, types };
}

export function floats(base64: string): Float32Array {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new Float32Array(bytes.buffer);
}

/** The belief of a step, from its blob or from the coefficients that an episode holds; null without one. */
export function densityOf(head: BeliefHead | null | undefined, blob?: ArrayBuffer): Density | null {
  if (!head) return null;
  const stored = head.coefficients;
  const values = blob ? new Float32Array(blob) : typeof stored === "string" ? floats(stored) : stored;
  return values ? { terms: termsOf(head.terms, values), level: head.level, undrawn: head.undrawn } : null;
}
