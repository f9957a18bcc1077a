// Made from studio/src/echoavatar_studio/wire*.py by scripts/make_studio_types.py; do not edit.

export const STATUS = {"bad_request": 400, "not_signed_in": 401, "bad_login": 401, "bad_invitation": 401, "bad_csrf": 403, "bad_origin": 403, "needs_consent": 403, "not_found": 404, "already_judged": 409, "key_reused": 409, "study_closed": 409, "study_full": 409, "busy": 409, "too_large": 413, "too_many_requests": 429, "internal": 500} as const;
export const QUESTIONS = ["human_likeness", "beat_matching", "overall_preference"] as const;
export const CATEGORIES = ["dance", "gesture"] as const;
export const MAX_CLIPS = 16 as const;

/** Krippendorff's alpha; null where it is not defined. */
export interface Agreement {
  question: string;
  metric: "interval" | "nominal" | "ordinal";
  alpha: number | null;
  units: number;
  raters: number;
}

/** Events, newest first; `before` in the query continues the list. */
export interface Audit {
  events: Event[];
}

/** Live progress of one category. */
export interface CellRow {
  category: "dance" | "gesture";
  sounds: number;
  done: number;
  of: number;
}

/** Open or close a study for raters. */
export interface ChangeState {
  state: "closed" | "open";
}

/** The rater has read the text and agrees. */
export interface Consent {
  agreed: boolean;
}

/** The request was carried out; there is nothing to return. */
export interface Done {
  ok: boolean;
}

/** A line of the audit. */
export interface Event {
  id: number;
  at: string;
  actor: string;
  action: string;
  study: string;
  detail: string;
}

/** Exclude a rater from the results, or include them again. */
export interface Exclude {
  is_excluded: boolean;
  reason?: string;
}

/** An invitation as the owner sees it later. */
export interface InvitationRow {
  id: number;
  label: string;
  is_open: boolean;
  seats: number;
  taken: number;
  is_revoked: boolean;
  created: string;
}

/** All invitations of a study. */
export interface Invitations {
  invitations: InvitationRow[];
}

/** New links: `count` personal ones, or one open link for so many raters. */
export interface Invite {
  count?: number;
  is_open?: boolean;
  label?: string;
}

/** The new links. */
export interface Invited {
  links: Link[];
}

/** An invitation, or the rater's own key from `Joined.resume`: the part of the link behind `#`. */
export interface Join {
  token: string;
}

/** Answer to `join` and `me`. */
export interface Joined {
  /** for the header X-CSRF-Token of every POST */
  csrf: string;
  study: StudyFace;
  has_consented: boolean;
  progress: Progress;
  /** link to go on with elsewhere; only when an open invitation was just taken, else empty */
  resume: string;
}

/** A link, shown only once: the studio keeps only a hash. */
export interface Link {
  id: number;
  url: string;
}

/** An owner's name and password. */
export interface Login {
  name: string;
  password: string;
}

/** Progress of making the clips of a new study. */
export interface Making {
  done: number;
  of: number;
  what: string;
}

/** A mean with its 95 % interval: mean - half to mean + half; null below two observations. */
export interface Mean {
  mean: number;
  /** over judgements, as in the paper */
  half: number | null;
  /** over raters' own means: mind it where raters differ */
  half_raters: number | null;
  count: number;
}

/** Set-up in the page: the text of a study.yaml. Paths are below the studio's library folder. */
export interface NewStudy {
  settings: string;
}

/** The rater's current task; the same until it is answered, in every tab and on every device. */
export interface NextTask {
  task: RaterTask | null;
  /** the one after it, to be loaded meanwhile */
  ahead: RaterTask | null;
  progress: Progress;
}

/** Answer to `login` and `me`. */
export interface OwnerSession {
  name: string;
  csrf: string;
}

/** One system against another; positive: the first is preferred. */
export interface PairRow {
  first: string;
  second: string;
  category: "dance" | "gesture";
  scores: Record<string, Mean>;
}

/** All questions of the study, each once. */
export interface PairwiseAnswer {
  type: "pairwise";
  ratings: Record<string, number>;
  /** from the task's first picture to the answer */
  seconds: number;
  /** times each clip was begun */
  plays: number[];
}

/** Best and worst, which must differ. */
export interface PreferenceAnswer {
  type: "preference";
  /** place of a clip in `RaterTask.clips` */
  best: number;
  /** place of a clip in `RaterTask.clips` */
  worst: number;
  seconds: number;
  plays: number[];
}

/** One sound of a preference study. */
export interface PreferenceRow {
  sound: string;
  category: "dance" | "gesture";
  votes: number;
  skips: number;
  /** candidate; null: no pair */
  chosen: number | null;
  rejected: number | null;
  agreement: number;
  margin: number;
  is_kept: boolean;
}

/** Every answer that is not 2xx. */
export interface Problem {
  code: "already_judged" | "bad_csrf" | "bad_invitation" | "bad_login" | "bad_origin" | "bad_request" | "busy" | "internal" | "key_reused" | "needs_consent" | "not_found" | "not_signed_in" | "study_closed" | "study_full" | "too_large" | "too_many_requests";
  /** English, for people; pages translate `code` */
  message: string;
  /** seconds; 0: trying again will not help */
  retry_after: number;
}

/** The progress of this rater. */
export interface Progress {
  /** tasks answered or skipped, training included */
  done: number;
  of: number;
  is_finished: boolean;
}

/** One rater's work, by number; there are no names. */
export interface RaterRow {
  id: number;
  /** of the invitation */
  label: string;
  joined: string;
  last_seen: string;
  has_consented: boolean;
  done: number;
  of: number;
  checks_passed: number;
  checks_failed: number;
  skipped: number;
  median_seconds: number;
  /** answers given before the clips could have been seen */
  too_fast: number;
  /** share of the commonest answer; 1: always the same */
  straight: number;
  /** correlation with the others' mean; null: too little */
  agreement: number | null;
  /** left out of results and export */
  is_excluded: boolean;
  reason: string;
}

/** One task to judge. */
export interface RaterTask {
  /** random; part of the addresses below */
  id: string;
  /** training: practice, does not count */
  stage: "rating" | "training";
  /** 1 is the first task */
  number: number;
  /** length of sound and of every clip */
  seconds: number;
  /** address of the sound, audio/flac */
  audio: string;
  /** addresses of the motion: 2 (pairwise) or N (preference) */
  clips: string[];
  /** sequential: which of the two clips is played first */
  first: number;
}

/** All raters of a study. */
export interface Raters {
  raters: RaterRow[];
}

/** A system's scores: positive is preferred. */
export interface ResultRow {
  system: string;
  /** heading of the table's rows; only systems of a group met */
  group: string;
  category: "dance" | "gesture";
  scores: Record<string, Mean>;
}

/** All results of a study so far. */
export interface Results {
  kind: "pairwise" | "preference";
  judgements: number;
  raters: number;
  excluded: number;
  rows: ResultRow[];
  pairs: PairRow[];
  ranking: Strength[];
  agreement: Agreement[];
  preferences: PreferenceRow[];
  /** names for `export/NAME`, image/svg+xml */
  plots: string[];
  /** names for `export/NAME`, files */
  exports: string[];
}

/** The rig that the clips move, for `AvatarDriver.bind` of @echoavatar/client. */
export interface RigInfo {
  names: string[];
  parents: number[];
  /** offset from the parent, metres */
  rest: ([number, number, number])[];
}

/** The judgement is on disk. The same key again gives the same answer with `is_repeated`. */
export interface Saved {
  is_repeated: boolean;
  progress: Progress;
}

/** Answer to `GET /api/scene`, the same for every rater. */
export interface Scene {
  rig: RigInfo;
  /** ARKit names, in the order of a clip's face curves */
  face: string[];
  frame_rate: number;
  /** address of the character's GLB */
  avatar: string;
}

/** What a study can be made of: answer to `GET /api/owner/setup`. */
export interface SetUp {
  templates: Template[];
  /** names of bundles, shipped and in the library */
  models: string[];
  /** folders of clips in the library */
  folders: string[];
  /** sound files and folders in the library */
  sounds: string[];
}

/** No clear difference (preference), or it cannot be judged (a clip does not play). */
export interface SkipAnswer {
  type: "skip";
  reason: "cannot_play" | "no_difference";
  seconds: number;
  plays: number[];
}

/** Bradley-Terry: log strength with its 95 % interval, mean of all systems 0. */
export interface Strength {
  system: string;
  group: string;
  question: "beat_matching" | "human_likeness" | "overall_preference";
  category: "dance" | "gesture" | "all";
  strength: number;
  low: number;
  high: number;
  rank: number;
}

/** One study in full. */
export interface StudyDetail {
  study: StudyRow;
  /** study.yaml as it was taken */
  settings: string;
  systems: SystemRow[];
  progress: CellRow[];
  /** judgements in each of the last 24 hours, oldest first */
  per_hour: number[];
}

/** What a rater may know of a study. */
export interface StudyFace {
  title: string;
  kind: "pairwise" | "preference";
  /** of the page, such as en */
  language: string;
  /** what the owner wrote for raters, plain text */
  intro: string;
  /** to be agreed to before the first task, plain text */
  consent: string;
  /** pairwise; in preference studies a grid */
  presentation: "sequential" | "side_by_side";
  /** pairwise: to be answered, in this order */
  questions: ("beat_matching" | "human_likeness" | "overall_preference")[];
  /** each clip is to be played so often before an answer */
  min_plays: number;
}

/** All studies, newest first. */
export interface StudyList {
  studies: StudyRow[];
}

/** A study in the list. */
export interface StudyRow {
  id: string;
  title: string;
  kind: "pairwise" | "preference";
  state: "closed" | "failed" | "making" | "open";
  /** ISO 8601, UTC */
  created: string;
  making: Making | null;
  /** why making failed; else empty */
  problem: string;
  /** who joined */
  raters: number;
  raters_wanted: number;
  /** that count: no training, no checks */
  judgements: number;
  judgements_wanted: number;
}

/** One of the systems that are compared. */
export interface SystemRow {
  name: string;
  source: string;
  clips: number;
  judgements: number;
}

/** A commented study.yaml to begin with. */
export interface Template {
  kind: "pairwise" | "preference";
  settings: string;
}

/** Delete all answers of this rater. */
export interface Withdraw {
  sure: true;
}

export type Answer = PairwiseAnswer | PreferenceAnswer | SkipAnswer;
