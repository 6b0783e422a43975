/** Queries and commands over HTTP. */

import type { ErrorBody, Hello, Reply } from "./messages.ts";
import { decodeState, type State } from "./state.ts";
import { currentToken } from "./token.ts";

/** A refusal, in the daemon's words; `code` is `away` when nobody answered. */
export class Refused extends Error {
  readonly code: string;
  readonly body: ErrorBody;

  constructor(body: ErrorBody) {
    super(body.message);
    this.code = body.code;
    this.body = body;
  }
}

const AWAY: ErrorBody = {
  code: "away",
  message: "the daemon does not answer: is it still running?",
  details: {},
  step: null,
};

/** How long a question may take; a command's own deadline is 5 s. */
const PATIENCE_MS = 15_000;

async function send(path: string, init: RequestInit): Promise<[Response, ArrayBuffer]> {
  const headers = new Headers(init.headers);
  const token = currentToken();
  if (token) {
    headers.set("Authorization", `Bearer ${token}`);
  }
  try {
    const signal = AbortSignal.timeout(PATIENCE_MS);
    const response = await fetch(path, { ...init, headers, signal, cache: "no-store" });
    return [response, await response.arrayBuffer()];
  } catch {
    throw new Refused(AWAY);
  }
}

async function ask<T>(path: string, init: RequestInit = {}): Promise<T> {
  const [response, bytes] = await send(path, init);
  return read<T>(response, bytes);
}

function read<T>(response: Response, bytes: ArrayBuffer): T {
  const text = new TextDecoder().decode(bytes);
  let body: unknown;
  try {
    body = JSON.parse(text);
  } catch {
    const message = `the daemon answered ${response.status} ${text.slice(0, 200)}`.trim();
    throw new Refused({ code: "internal", message, details: {}, step: null });
  }
  if (!response.ok) {
    throw new Refused(body as ErrorBody);
  }
  return body as T;
}

export function hello(): Promise<Hello> {
  return ask("/api/hello");
}

/** Asks a swarm: `what` is a noun, with its parameters as in `events?after=12`. */
export function get<T>(swarm: string, what: string): Promise<Reply<T>> {
  return ask(`/api/get/${encodeURIComponent(swarm)}/get/${what}`);
}

/** The state of a swarm as it is now. */
export async function currentState(swarm: string): Promise<State> {
  const [response, bytes] = await send(`/api/get/${encodeURIComponent(swarm)}/state`, {});
  return response.ok ? decodeState(bytes) : read<never>(response, bytes);
}

/** Names a request, so that one sent twice is carried out once. */
function requestId(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** What a command may demand of the swarm that executes it. */
export interface Demands {
  expect_epoch?: number;
}

function post<T>(path: string, args: object, demands: Demands = {}): Promise<T> {
  const request = { request_id: requestId(), client: "page", ...demands, args };
  const headers = { "Content-Type": "application/json" };
  return ask(path, { method: "POST", headers, body: JSON.stringify(request) });
}

export function command<T>(
  swarm: string,
  verb: string,
  args: object = {},
  demands: Demands = {},
): Promise<Reply<T>> {
  return post(`/api/cmd/${encodeURIComponent(swarm)}/${verb}`, args, demands);
}

export function commandNode<T>(verb: string, args: object): Promise<T> {
  return post(`/api/node/${verb}`, args);
}
