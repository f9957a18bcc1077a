/** Requests to the studio: JSON, the CSRF token, and two kinds of failure. */

import type { Problem } from "./api.generated.js";

const SECONDS = 30; // timeout of a request
const FILE_SECONDS = 300; // timeout of a file download

/** The studio refused the request and gave a reason. */
export class Refused extends Error {
  override readonly name = "Refused";

  constructor(readonly problem: Problem) {
    super(problem.message);
  }

  get code(): Problem["code"] {
    return this.problem.code;
  }
}

/** No answer, or an answer of something other than the studio: the request may or may not have taken effect. */
export class Unreachable extends Error {
  override readonly name = "Unreachable";
}

export class Api {
  /** Sent as X-CSRF-Token; returned by `join`, `login` and `me`. */
  csrf = "";

  get<Answer>(path: string): Promise<Answer> {
    return this.json(path, { method: "GET" });
  }

  post<Answer>(path: string, body: object | null = null, headers: Record<string, string> = {}): Promise<Answer> {
    const kind = { "content-type": "application/json", "x-csrf-token": this.csrf, ...headers };
    return this.json(path, { method: "POST", headers: kind, body: body === null ? null : JSON.stringify(body) });
  }

  delete<Answer>(path: string): Promise<Answer> {
    const headers = { "content-type": "application/json", "x-csrf-token": this.csrf };
    return this.json(path, { method: "DELETE", headers });
  }

  /** Fetches a whole file of a task. */
  async bytes(path: string): Promise<ArrayBuffer> {
    const response = await reach(path, { method: "GET" }, FILE_SECONDS);
    try {
      if (response.ok) return await response.arrayBuffer();
    } catch (error) {
      throw new Unreachable(String(error));
    }
    throw await refusal(response);
  }

  private async json<Answer>(path: string, request: RequestInit): Promise<Answer> {
    const response = await reach(path, request);
    if (!response.ok) throw await refusal(response);
    try {
      return (await response.json()) as Answer;
    } catch (error) {
      throw new Unreachable(String(error)); // the connection broke during the answer
    }
  }
}

async function reach(path: string, request: RequestInit, seconds = SECONDS): Promise<Response> {
  try {
    return await fetch(path, { ...request, credentials: "same-origin", signal: AbortSignal.timeout(seconds * 1000) });
  } catch (error) {
    throw new Unreachable(String(error));
  }
}

/** The `Problem` of an answer. An answer without one comes from a proxy in between. */
async function refusal(response: Response): Promise<Refused | Unreachable> {
  try {
    const problem = (await response.json()) as Problem;
    if (typeof problem.code === "string") return new Refused(problem);
  } catch {
    // handled below
  }
  return new Unreachable(`the answer was ${response.status}, not the studio's`);
}
