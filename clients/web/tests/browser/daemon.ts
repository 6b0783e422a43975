/** A daemon of its own for each test: the binary that JOSTLED names, on ports of its own. */
import assert from "node:assert/strict";
import { type ChildProcess, execFile, spawn } from "node:child_process";
import { mkdtempSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { promisify } from "node:util";

export interface Told {
  zenoh: string;
  http: string;
  token: string;
}

export class Daemon {
  told: Told = { zenoh: "", http: "", token: "" };
  private process: ChildProcess | null = null;
  private auth: string | null = null;
  private readonly folder = mkdtempSync(join(tmpdir(), "jostle-page-"));

  /** A daemon; with `auth`, the folder of its people, one that knows them. */
  static async start(auth: string | null = null): Promise<Daemon> {
    const daemon = new Daemon();
    daemon.auth = auth;
    await daemon.begin("tcp/127.0.0.1:0", "127.0.0.1:0");
    return daemon;
  }

  /** Starts it again where it was, with what it kept. */
  async again(): Promise<void> {
    await this.begin(this.told.zenoh, this.told.http.replace("http://", ""));
  }

  async kill(): Promise<void> {
    const { process } = this;
    this.process = null;
    if (process && process.exitCode === null) {
      const gone = new Promise((resolve) => process.once("exit", resolve));
      process.kill("SIGKILL");
      await gone;
    }
  }

  async end(): Promise<void> {
    await this.kill();
    rmSync(this.folder, { recursive: true, force: true });
  }

  get link(): string {
    return `${this.told.http}/#token=${this.told.token}`;
  }

  async get<T>(path: string): Promise<T> {
    const response = await fetch(`${this.told.http}/api/get/${path}`);
    return (await response.json()) as T;
  }

  post(path: string, args: object, token: string | null = this.told.token): Promise<Response> {
    const headers: Record<string, string> = { "Content-Type": "application/json" };
    if (token !== null) {
      headers.Authorization = `Bearer ${token}`;
    }
    return fetch(this.told.http + path, { method: "POST", headers, body: JSON.stringify(args) });
  }

  async command<T>(swarm: string, verb: string, args: object = {}): Promise<T> {
    const response = await this.post(`/api/cmd/${swarm}/${verb}`, args);
    assert.equal(response.status, 200, `${verb}: ${await response.clone().text()}`);
    return (await response.json()) as T;
  }

  async create(name: string, spec: object): Promise<void> {
    const response = await this.post("/api/node/create", { name, spec });
    assert.equal(response.status, 200, `create: ${await response.clone().text()}`);
  }

  /** Carries out a line of the command line, which lies beside the daemon. */
  async jostle(...line: string[]): Promise<string> {
    const jostle = join(dirname(process.env.JOSTLED ?? ""), "jostle");
    const run = promisify(execFile);
    return (await run(jostle, ["-e", this.told.zenoh, ...line], { cwd: this.folder })).stdout;
  }

  private begin(listen: string, http: string): Promise<void> {
    const binary = process.env.JOSTLED;
    assert(binary, "JOSTLED names the daemon's binary");
    const people = this.auth === null ? [] : ["--auth-dir", this.auth];
    const args = ["--listen", listen, "--http", http, "--data-dir", this.folder, ...people];
    const child = spawn(binary, args, { stdio: ["ignore", "pipe", "pipe"] });
    this.process = child;
    let said = "";
    return new Promise((resolve, reject) => {
      const hear = (chunk: Buffer) => {
        said += chunk;
        const zenoh = /listening on (\S+)/.exec(said)?.[1];
        const http = /http on (http:\/\/[^/\s]+)/.exec(said)?.[1];
        // Told to no terminal, the token is only where it is kept; with people there is none.
        const page = /with the token in (\S+)\n/.exec(said)?.[1];
        if (zenoh && http && (page || this.auth)) {
          const token = page ? readFileSync(page, "utf8").trim() : "";
          this.told = { zenoh, http, token };
          resolve();
        }
      };
      child.stdout?.on("data", hear);
      child.stderr?.on("data", hear);
      child.once("exit", (code) => reject(new Error(`jostled ended with ${code}: ${said}`)));
    });
  }
}
