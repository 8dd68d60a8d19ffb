/** Requests to the server. Failures are thrown as `Refused`, with the server's words. */

import { words } from "../words";
import type { Episode, Problem, Run, RunEntry, ServerState, Upload } from "./messages";

export class Refused extends Error implements Problem {
  constructor(readonly problem: string, readonly change: string) {
    super(problem);
  }
}

/** An address with the token that a server beyond this machine wants; it stands in the page's own address. */
export function address(path: string): string {
  const known = new URLSearchParams(location.search).get("token");
  return known ? `${path}?token=${encodeURIComponent(known)}` : path;
}

async function ask<T>(path: string, options?: RequestInit): Promise<T> {
  let response: Response;
  try {
    response = await fetch(address(path), options);
  } catch (error) {
    if (options?.signal?.aborted) throw error;
    throw new Refused(words.problems.gone, words.problems.goneChange);
  }
  if (response.ok) return response.json();
  const told = await response.json().catch(() => null);
  throw new Refused(
    told?.problem ?? words.problems.refused(response.status), told?.change ?? words.problems.refusedChange);
}

export const serverState = () => ask<ServerState>("api/state");
export const runs = () => ask<{ folder: string; runs: RunEntry[] }>("api/runs");
export const run = (name: string) => ask<Run>(`api/runs/${encodeURIComponent(name)}`);

/** An episode; the server may need a while to play it again. */
export async function episode(name: string, key: string, signal: AbortSignal): Promise<Episode> {
  const path = `api/runs/${encodeURIComponent(name)}/episodes/${encodeURIComponent(key)}`;
  const told = await ask<Episode>(path, { signal });
  for (const { panorama } of told.steps) if (panorama?.url) panorama.url = address(panorama.url);
  return told;
}

export function upload(file: File): Promise<Upload> {
  const headers = { "X-Name": encodeURIComponent(file.name), "Content-Type": "application/octet-stream" };
  return ask("api/pictures", { method: "POST", body: file, headers });
}
