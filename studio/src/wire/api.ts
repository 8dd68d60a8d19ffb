/** Requests to the server. Failures are thrown as `Refused`, with the server's words. */

import { words } from "../words";
import type { Episode, Picture, Problem, Run, RunEntry, ServerState } from "./messages";

export class Refused extends Error implements Problem {
  constructor(readonly problem: string, readonly change: string) {
    super(problem);
  }
}

/** The token that a server beyond this machine wants; it stands in the page's address. */
export function token(): string | null {
  return new URLSearchParams(location.search).get("token");
}

export function address(path: string): string {
  const known = token();
  return known ? `${path}${path.includes("?") ? "&" : "?"}token=${encodeURIComponent(known)}` : path;
}

async function ask(path: string, options?: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(address(path), options);
  } catch {
    throw new Refused(words.problems.gone, words.problems.goneChange);
  }
  if (response.ok) return response;
  const told = await response.json().catch(() => null);
  throw new Refused(
    told?.problem ?? words.problems.refused(response.status),
    told?.change ?? words.problems.refusedChange,
  );
}

export async function serverState(): Promise<ServerState> {
  return (await ask("api/state")).json();
}

export async function runs(): Promise<{ folder: string; runs: RunEntry[] }> {
  return (await ask("api/runs")).json();
}

export async function run(name: string): Promise<Run> {
  return (await ask(`api/runs/${encodeURIComponent(name)}`)).json();
}

/** An episode; the server may need a while to draw it again and says how far it is. */
export async function episode(
  name: string, key: string, told: (progress: number | null) => void, signal: AbortSignal,
): Promise<Episode> {
  const path = `api/runs/${encodeURIComponent(name)}/episodes/${encodeURIComponent(key)}`;
  for (;;) {
    const response = await ask(path, { signal });
    if (response.status !== 202) return response.json();
    told((await response.json()).progress ?? null);
    await new Promise((resolve) => setTimeout(resolve, 400));
    signal.throwIfAborted();
  }
}

export async function upload(file: File): Promise<Picture> {
  const headers = { "X-Name": encodeURIComponent(file.name), "Content-Type": "application/octet-stream" };
  return (await ask("api/pictures", { method: "POST", body: file, headers })).json();
}
