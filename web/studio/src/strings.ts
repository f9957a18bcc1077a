/**
 * Every word that the pages say. To translate: add a language with the same keys to `LANGUAGES`; a study's `language`
 * chooses it for its raters, and what a language lacks is said in English. `{name}` is filled in.
 */

const en = {
  // Everywhere
  yes_delete: "Delete", cancel: "Cancel", close: "Close", back: "Back", loading: "Loading…", retrying: "No connection. Trying again in {seconds} s.",
  retry_now: "Try now", waiting: "The studio is busy. Going on in {seconds} s.", copied: "Copied", copy: "Copy",

  // Problems, by the code that the studio gives
  problem_bad_request: "The studio did not accept this: {message}", problem_too_large: "This is too much at once.",
  problem_not_signed_in: "You are not signed in.", problem_bad_login: "Name or password is wrong.",
  problem_bad_invitation: "This link is not valid. Perhaps a part of it is missing, or it was withdrawn.",
  problem_bad_csrf: "This page is out of date. Please load it again.", problem_bad_origin: "This page may not talk to the studio.",
  problem_needs_consent: "Please read the text first.", problem_not_found: "This does not exist, or is no longer yours.",
  problem_already_judged: "This was answered before.", problem_key_reused: "This was answered before.",
  problem_study_closed: "This study is closed. Thank you for coming.",
  problem_study_full: "Everybody this link was meant for has come. Ask for another one.",
  problem_busy: "This is not possible now: {message}", problem_too_many_requests: "Too many requests. Please wait a little.",
  problem_internal: "The studio made a mistake. Please try again.", problem_unreachable: "The studio does not answer. Check your connection.",
  problem_unknown: "Something went wrong: {message}",

  // Raters: before and after
  rate_no_link_title: "Open your invitation", rate_no_link: "This page belongs to a study. Open the whole link that you were given: the part behind # is your key.",
  rate_refused_title: "This did not work", rate_welcome: "Before we begin", rate_consent_title: "Your consent",
  rate_agree: "I agree, let us begin", rate_disagree: "I do not agree", rate_kept_nothing_title: "Nothing was kept",
  rate_kept_nothing: "Your place is free again, and nothing about you was stored. You may close this page.",
  rate_resume: "To go on later or on another device, keep this link. It is yours alone.", rate_finished_title: "Thank you, that was all",
  rate_finished: "All {of} answers are saved. You may close this page.", rate_left_title: "See you later",
  rate_left: "What you answered is saved. Open your link again to go on.", rate_leave: "Leave and go on later",
  rate_withdraw: "Delete my answers", rate_withdraw_ask: "Delete everything you gave and leave the study? This cannot be undone.",
  rate_withdrawn_title: "Everything was deleted", rate_withdrawn: "Your answers are gone. Thank you all the same.",

  // Raters: a task
  task_progress: "{number} of {of}", task_progress_label: "{done} of {of} answered", task_training: "Practice. This one does not count.",
  task_title_pairwise: "Which one moves better?", task_title_preference: "Pick the best and the worst",
  task_hint_side: "Play both, then answer the questions.", task_hint_sequential: "Watch one after the other, then answer the questions.",
  task_hint_preference: "Watch every one to its end. Then mark the best and the worst.", task_preparing: "Getting ready… {percent} %",
  task_broken: "This one could not be loaded: {message}", task_no_webgl: "Your browser cannot show 3D: {message}. Another browser or device may.",
  play: "Play", pause: "Pause", play_all: "Play all", play_both: "Play both", play_clip: "Play {name}", again: "From the start", loop: "Repeat", sound: "Sound",
  view: "View", view_left: "Turn left", view_right: "Turn right", view_closer: "Closer", view_farther: "Farther", view_reset: "First view",
  clip_name: "Motion {name}", clip_begun: "played {count} times", clip_watched: "watched", clip_waits: "Not yet", clip_next: "Next: {name}",
  best: "Best", worst: "Worst", mark_best: "{name} is the best", mark_worst: "{name} is the worst", chosen: "Best: {best}. Worst: {worst}.", none: "none yet",
  still_to_watch: "Still to watch: {names}", still_to_answer: "Still to answer: {count}", still_to_mark: "Mark the best and the worst",
  grid: "All at once", one: "One at a time", previous: "Previous", next: "Next",
  submit: "Save and go on", submit_training: "Got it, go on", skip: "No clear difference", broken: "It does not play",
  broken_ask: "Say that this one cannot be judged, and go on? Try again first: it may play after all.", broken_yes: "Cannot be judged",
  saving: "Saving…", saved: "Saved", not_saved: "Not saved yet: no connection. Trying again in {seconds} s. Keep this page open.",
  not_saved_busy: "Not saved yet: the studio asks to wait {seconds} s.", saved_elsewhere: "This one was answered in another tab or on another device. Here is the next.",
  stuck: "The sound does not start. Is a loudspeaker connected?", help: "Keys", menu: "More",
  question_human_likeness: "Which one moves more like a human being?", question_beat_matching: "Which one fits the sound better?",
  question_overall_preference: "Which one do you prefer, all in all?",
  rating_m2: "{a} much better", rating_m1: "{a} a bit better", rating_0: "no difference", rating_1: "{b} a bit better", rating_2: "{b} much better",
  key_space: "Play or pause", key_again: "From the start", key_number: "Play that one", key_arrows: "Previous or next", key_best: "Mark as best", key_worst: "Mark as worst",
  key_turn: "Turn the view", key_zoom: "Closer or farther", key_view: "First view", key_mute: "Sound on or off", key_submit: "Save and go on", key_rate: "Within a question: choose", key_help: "This list",

  // Owners
  owner_title: "Studio", owner_sign_in: "Sign in", owner_name: "Name", owner_password: "Password", owner_sign_out: "Sign out", owner_studies: "Studies",
  owner_audit: "Audit", owner_new: "New study", owner_no_studies: "There is no study yet.", state_making: "being made", state_open: "open", state_closed: "closed", state_failed: "failed",
  kind_pairwise: "pairwise", kind_preference: "preference", owner_judgements: "{done} of {of} judgements", owner_raters: "{here} of {of} raters", making: "{what}: {done} of {of}",
  tab_overview: "Progress", tab_invite: "Invitations", tab_raters: "Raters", tab_results: "Results", tab_settings: "Settings", tab_audit: "Audit",
  open_study: "Open for raters", close_study: "Close", delete_study: "Delete study", delete_study_ask: "Delete “{title}” with all clips, raters and answers?",
  by_category: "By category", by_system: "By system", per_hour: "Answers in the last 24 hours, practice and checks too", hours_ago: "{hours} h ago", now: "now",
  category: "Category", category_dance: "Dance", category_gesture: "Gesture", category_all: "All", sounds: "Sounds", done: "Done", of: "Of", system: "System", source: "Source", clips: "Clips", judgements: "Judgements",
  invite_count: "How many", invite_kind: "Kind", invite_personal: "Personal", invite_open: "Open", invite_explain: "Personal: as many links, one for each rater. Open: one link for as many raters.", invite_label: "Label", invite_make: "Make links",
  invite_once: "These links are shown once. The studio keeps no copy.", invite_label_hint: "for you alone", copy_all: "Copy all", invite_seats: "{taken} of {seats} taken", invite_revoke: "Revoke", invite_revoked: "revoked",
  invite_revoke_ask: "Revoke this link? Who has joined already can go on.", none_yet: "None yet.", created: "Created", label: "Label", link: "Link", seats: "Seats",
  rater: "Rater", rater_number: "No. {id}", answered: "Answered", checks: "Checks", checks_value: "{passed} passed, {failed} failed", skipped: "Skipped", median: "Median time", too_fast: "Too fast", straight: "Same answer", agreement_others: "Agreement", last_seen: "Last seen",
  exclude: "Leave out", include: "Take in", exclude_reason: "Reason", exclude_ask: "Leave rater {id} out of results and exports?", excluded: "left out", delete_rater: "Delete", delete_rater_ask: "Delete rater {id} and all answers of this rater? This cannot be undone.",
  suspicious: "worth a look", results_summary: "{judgements} judgements of {raters} raters; {excluded} left out.", results_none: "There is nothing to count yet.", scores: "Scores", scores_note: "Mean and 95 % interval over judgements, on −2 to 2. Positive: preferred.",
  half_raters_note: "In brackets: half the interval over raters’ own means.", pairs: "Pairs", first_against: "{first} against {second}", ranking: "Bradley-Terry ranking", ranking_note: "Log strength with its 95 % interval; the mean of all is 0.", rank: "Rank", strength: "Strength", interval: "95 % interval",
  agreement: "Agreement between raters", agreement_note: "Krippendorff’s alpha: 1 is full agreement, 0 is chance.", question: "Question", metric: "Metric", alpha: "Alpha", units: "Units", raters: "Raters", undefined: "not defined",
  preferences: "Pairs for align dpo", preferences_note: "{kept} of {all} sounds give a pair.", sound_name: "Sound", votes: "Votes", skips: "Skips", chosen_candidate: "Chosen", rejected_candidate: "Rejected", share: "Agreement", margin: "Margin", kept: "Kept", no: "no", yes: "yes", metric_interval: "interval", metric_nominal: "nominal", metric_ordinal: "ordinal",
  q_human_likeness: "Human likeness", q_beat_matching: "Beat matching", q_overall_preference: "Overall preference", q_best: "Best", q_worst: "Worst", export: "Export", export_plots: "Plots",
  audit_when: "When", audit_who: "Who", audit_what: "What", audit_detail: "Detail", audit_more: "Older", settings_taken: "study.yaml as it was taken",

  // Owners: set-up. One word for each field of study.yaml
  setup_form: "Form", setup_text: "study.yaml", setup_make: "Make the study", setup_invalid: "Please fill in: {fields}", setup_bad: "The studio did not accept this: {message}", setup_add: "Add", setup_remove: "Remove", setup_basics: "Study", setup_compared: "What is compared", setup_sounds: "Sounds", setup_people: "Raters and tasks", setup_texts: "Texts", setup_keep: "Which pairs are kept", setup_own_text: "Leave empty for the studio’s own text.",
  field_kind: "Kind", field_title: "Title", field_language: "Language of the raters’ page", field_intro: "Welcome to raters", field_consent: "Consent text", field_raters: "Raters", field_tasks_per_rater: "Tasks for each rater", field_training: "Practice tasks", field_identical: "Checks: the same clip twice", field_corrupted: "Checks: a broken clip", field_min_plays: "Each clip to be watched", field_seed: "Seed of the design", field_seconds: "Seconds a clip", field_presentation: "Shown", field_questions: "Questions", field_model: "Model", field_candidates: "Candidates", field_past: "Chunks before they part", field_length: "Chunks of a candidate", field_prompts_per_sound: "Stretches of each sound", field_votes: "Votes needed", field_agreement: "Agreement, at least", field_margin: "Margin, at least", field_name: "Name", field_source: "Made by", field_clips: "Folder of clips", field_system_seed: "Seed", field_group: "Group", field_path: "File or folder", field_category: "Category", field_start: "From second", source_model: "a model", source_clips: "a folder of clips",
  presentation_side_by_side: "side by side, in sync", presentation_sequential: "one after the other", kind_pairwise_long: "Pairwise: two systems, three questions", kind_preference_long: "Preference: best and worst of several",
};

export type Key = keyof typeof en;
const LANGUAGES: Record<string, Partial<Record<Key, string>>> = { en };
let chosen: Partial<Record<Key, string>> = en;

/** Speaks a language, such as en or de-AT; unknown ones are English. */
export function speak(language: string): void {
  const known = [language, language.split("-")[0]!].find((code) => code in LANGUAGES) ?? "en";
  chosen = LANGUAGES[known]!;
  document.documentElement.lang = known;
}

/** What to say. */
export function t(key: Key, values: Record<string, string | number> = {}): string {
  return (chosen[key] ?? en[key]).replace(/\{(\w+)\}/g, (whole, name: string) => String(values[name] ?? whole));
}

/** The word of a code that came from the studio: `t` for keys that are put together. */
export function word(prefix: string, code: string): string {
  const key = `${prefix}_${code}`;
  return key in en ? t(key as Key) : code;
}
