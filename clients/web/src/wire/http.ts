/** Queries and commands over HTTP. */

import type { Reply } from "./messages.ts";
import type { Hello, Problem } from "./page.ts";
import { readSnapshot, type Snapshot } from "./snapshot.ts";
import { decodeState, type State } from "./state.ts";
import { currentToken } from "./token.ts";

/** An error reply of the daemon; `code` is `no_reply` if the request failed or timed out. */
export class RequestError extends Error {
  readonly code: string;
  readonly body: Problem;

  constructor(body: Problem) {
    super(body.message);
    this.code = body.code;
    this.body = body;
  }
}

const NO_REPLY: Problem = {
  code: "no_reply",
  message: "no reply from the daemon: check that it is running",
  details: {},
  step: null,
};

/** Longer than the daemon's own deadline for commands, 5 s. */
const REQUEST_TIMEOUT_MS = 15_000;
const MIN_RETRY_MS = 100;
const MAX_RETRY_MS = 1000;

async function send(path: string, init: RequestInit): Promise<[Response, ArrayBuffer]> {
  const headers = new Headers(init.headers);
  const token = currentToken();
  if (token) {
    headers.set("Authorization", `Bearer ${token}`);
  }
  try {
    const signal = AbortSignal.timeout(REQUEST_TIMEOUT_MS);
    const response = await fetch(path, { ...init, headers, signal, cache: "no-store" });
    return [response, await response.arrayBuffer()];
  } catch {
    throw new RequestError(NO_REPLY);
  }
}

/** Reasons for which a daemon has executed nothing and soon will. */
const PASSING = ["handover", "recovering"];

async function request<T>(path: string, init: RequestInit = {}): Promise<T> {
  return retried(async () => read<T>(...(await send(path, init))));
}

/** Sends a request again while the daemon recovers its swarms or hands one over, until the timeout. */
async function retried<T>(attempt: () => Promise<T>): Promise<T> {
  const deadline = Date.now() + REQUEST_TIMEOUT_MS;
  for (let pause = MIN_RETRY_MS; ; pause = Math.min(2 * pause, MAX_RETRY_MS)) {
    try {
      return await attempt();
    } catch (error) {
      if (!isPassing(error) || Date.now() + pause >= deadline) {
        throw error;
      }
      await new Promise((resolve) => setTimeout(resolve, pause));
    }
  }
}

/** Whether an error is one after which the same request is sent again. */
function isPassing(error: unknown): boolean {
  return (
    error instanceof RequestError &&
    error.code === "busy" &&
    PASSING.includes(String(error.body.details.reason))
  );
}

function read<T>(response: Response, bytes: ArrayBuffer): T {
  const text = new TextDecoder().decode(bytes);
  let body: unknown;
  try {
    body = JSON.parse(text);
  } catch {
    const message =
      `the daemon replied with status ${response.status} ${text.slice(0, 200)}`.trim();
    throw new RequestError({ code: "internal", message, details: {}, step: null });
  }
  if (!response.ok) {
    throw new RequestError(body as Problem);
  }
  return body as T;
}

export function hello(): Promise<Hello> {
  return request("/api/hello");
}

/** Queries a swarm; `what` is a noun with its parameters, such as `events?after=12`. */
export function get<T>(swarm: string, what: string): Promise<Reply<T>> {
  return request(`/api/get/${encodeURIComponent(swarm)}/get/${what}`);
}

/** The current state of a swarm. */
export async function currentState(swarm: string): Promise<State> {
  return retried(async () => {
    const [response, bytes] = await send(`/api/get/${encodeURIComponent(swarm)}/state`, {});
    return response.ok ? decodeState(bytes) : read<never>(response, bytes);
  });
}

/** A snapshot of a swarm. */
export async function currentSnapshot(swarm: string): Promise<Snapshot> {
  return retried(async () => {
    const [response, bytes] = await send(`/api/get/${encodeURIComponent(swarm)}/get/snapshot`, {});
    return response.ok ? readSnapshot(new Uint8Array(bytes)) : read<never>(response, bytes);
  });
}

/** A new request id: the daemon executes a request that is sent twice once. */
function requestId(): string {
  const bytes = crypto.getRandomValues(new Uint8Array(12));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Preconditions of a command. */
export interface Preconditions {
  expect_epoch?: number;
}

function post<T>(path: string, args: object, preconditions: Preconditions = {}): Promise<T> {
  const envelope = { request_id: requestId(), client: "page", ...preconditions, args };
  const headers = { "Content-Type": "application/json" };
  return request(path, { method: "POST", headers, body: JSON.stringify(envelope) });
}

export function command<T>(
  swarm: string,
  verb: string,
  args: object = {},
  preconditions: Preconditions = {},
): Promise<Reply<T>> {
  return post(`/api/cmd/${encodeURIComponent(swarm)}/${verb}`, args, preconditions);
}

export function commandNode<T>(verb: string, args: object): Promise<T> {
  return post(`/api/node/${verb}`, args);
}
