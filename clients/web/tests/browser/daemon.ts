/** A daemon of its own for each test: the binary that JOSTLED names, on ports of its own. */
import assert from "node:assert/strict";
import { type ChildProcess, execFile, execFileSync, spawn } from "node:child_process";
import {
  chmodSync,
  chownSync,
  copyFileSync,
  mkdirSync,
  mkdtempSync,
  readFileSync,
  rmSync,
  writeFileSync,
} from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { promisify } from "node:util";

export interface Told {
  zenoh: string;
  http: string;
  token: string;
}

/** A user such as systemd allocates for a unit with DynamicUser. */
export const DYNAMIC_USER = 61_200;

export const isRoot = process.getuid?.() === 0;

/** The daemon closes a connection after 5 s idle, which can race with the next request. */
const CLOSE = { Connection: "close" };

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

  /**
   * One that runs as packaging/jostled.service runs it, as far as that takes no systemd: `serve` with
   * the settings of the package, its data below $STATE_DIRECTORY, nothing of it for others to read,
   * and, where the tests are root's, a user of its own.
   */
  static async startAsService(): Promise<Daemon> {
    const daemon = new Daemon();
    const { folder } = daemon;
    const state = join(folder, "jostle");
    mkdirSync(state, { mode: 0o700 });
    const config = join(folder, "jostled.toml");
    writeFileSync(config, execFileSync(binary(), ["config", "default"]));
    const user = isRoot ? { uid: DYNAMIC_USER, gid: DYNAMIC_USER } : {};
    let program = binary();
    if (isRoot) {
      // Every user may enter the folder itself, as /var/lib.
      chmodSync(folder, 0o755);
      chownSync(state, DYNAMIC_USER, DYNAMIC_USER);
      // The checkout may be in a folder that only root may enter.
      program = join(folder, "jostled");
      copyFileSync(binary(), program);
    }
    const child = spawn(
      "sh",
      ["-c", 'umask 0077; exec "$0" "$@"', program, "serve", "--config", config],
      {
        ...user,
        stdio: ["ignore", "pipe", "pipe"],
        cwd: "/",
        env: {
          PATH: process.env.PATH,
          STATE_DIRECTORY: state,
          JOSTLED_LISTEN: "tcp/127.0.0.1:0",
          JOSTLED_HTTP: "127.0.0.1:0",
        },
      },
    );
    await daemon.hear(child);
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
    const response = await fetch(`${this.told.http}/api/get/${path}`, { headers: CLOSE });
    return (await response.json()) as T;
  }

  post(path: string, args: object, token: string | null = this.told.token): Promise<Response> {
    const headers: Record<string, string> = { ...CLOSE, "Content-Type": "application/json" };
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
    const people = this.auth === null ? [] : ["--auth-dir", this.auth];
    const args = ["--listen", listen, "--http", http, "--data-dir", this.folder, ...people];
    return this.hear(spawn(binary(), args, { stdio: ["ignore", "pipe", "pipe"] }));
  }

  /** Waits until it says where it listens. */
  private hear(child: ChildProcess): Promise<void> {
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

function binary(): string {
  const binary = process.env.JOSTLED;
  assert(binary, "JOSTLED names the daemon's binary");
  return binary;
}
