/** The form that sets a study up: fields, or the text of study.yaml. */

import { CATEGORIES, QUESTIONS, type SetUp } from "../api.generated.js";
import { h } from "../dom.js";
import { type Key, t, word } from "../strings.js";
import {
  CANDIDATES,
  CLIP_SECONDS,
  type Choices,
  KEEPING,
  type Kind,
  type NumberField,
  PEOPLE,
  beginChoices,
  newSound,
  newSystem,
  settingsOf,
} from "./fields.js";
import { field, fields, number, numberField, option, text } from "./inputs.js";
import { section } from "./table.js";
import { toYaml } from "./yaml.js";

export class SetupForm {
  readonly element = h("div", { class: "setup" });
  private readonly choices = beginChoices();
  private readonly area = h("textarea", {
    class: "yaml",
    rows: 28,
    spellcheck: "false",
    "aria-label": t("setup_text"),
    maxlength: 20_000,
  });
  private form = h("form", { class: "parts" });
  private isText = false;

  constructor(private readonly known: SetUp) {
    this.draw();
  }

  get text(): string {
    return this.isText ? this.area.value : toYaml(settingsOf(this.choices));
  }

  /** Lets the browser point at the first invalid field. */
  isValid(): boolean {
    return this.isText || this.form.reportValidity();
  }

  private draw(): void {
    const tab = (isText: boolean, label: string) =>
      h(
        "button",
        {
          class: "button small",
          type: "button",
          "aria-pressed": this.isText === isText ? "true" : "false",
          onclick: () => this.turn(isText),
        },
        label,
      );
    const templates = this.known.templates.map((template) =>
      h(
        "button",
        { class: "button small", type: "button", onclick: () => (this.area.value = template.settings) },
        word("kind", template.kind),
      ),
    );
    this.form = h("form", { class: "parts", onsubmit: (event) => event.preventDefault() }, ...this.sections());
    this.element.replaceChildren(
      h(
        "div",
        { class: "row switch", role: "group" },
        tab(false, t("setup_form")),
        tab(true, t("setup_text")),
        ...(this.isText ? [h("span", { class: "gap" }), ...templates] : []),
      ),
      this.isText ? this.area : this.form,
    );
  }

  private turn(isText: boolean): void {
    if (isText && !this.isText) this.area.value = toYaml(settingsOf(this.choices));
    this.isText = isText;
    this.draw();
  }

  private sections(): HTMLElement[] {
    const { choices } = this;
    const kinds = h(
      "select",
      {
        name: "kind",
        onchange: (event) => {
          choices.kind = (event.target as HTMLSelectElement).value as Kind;
          this.draw();
        },
      },
      ...(["pairwise", "preference"] as const).map((kind) =>
        option(kind, t(`kind_${kind}_long`), kind === choices.kind),
      ),
    );
    const basics = section(
      t("setup_basics"),
      fields(
        field(t("field_kind"), kinds),
        this.words("title", "field_title", { required: true, maxlength: 200 }),
        this.words("language", "field_language", { required: true, pattern: "[a-z]{2}(-[A-Z]{2})?" }),
      ),
    );
    const people = section(t("setup_people"), this.numbers(PEOPLE));
    const texts = section(
      t("setup_texts"),
      this.long("intro", "field_intro", 4000),
      this.long("consent", "field_consent", 8000),
    );
    return [
      basics,
      choices.kind === "pairwise" ? this.systems() : this.candidates(),
      this.sounds(),
      people,
      ...(choices.kind === "preference" ? [section(t("setup_keep"), this.numbers(KEEPING))] : []),
      texts,
      this.lists(),
    ];
  }

  private systems(): HTMLElement {
    const { systems } = this.choices;
    const rows = systems.map((system, k) => {
      const source = h(
        "select",
        {
          onchange: (event) => {
            system.source = (event.target as HTMLSelectElement).value as "model" | "clips";
            this.draw();
          },
        },
        option("model", t("source_model"), system.source === "model"),
        option("clips", t("source_clips"), system.source === "clips"),
      );
      const place =
        system.source === "model"
          ? [
              text(system, "model", t("field_model"), { required: true, list: "models" }),
              number(system, "seed", t("field_system_seed"), 0),
            ]
          : [text(system, "clips", t("field_clips"), { required: true, list: "folders" })];
      return this.listRow(
        "system",
        systems,
        k,
        2,
        text(system, "name", t("field_name"), { required: true, maxlength: 80 }),
        field(t("field_source"), source),
        ...place,
        text(system, "group", t("field_group"), { maxlength: 80 }),
      );
    });
    const shown = h(
      "select",
      {
        name: "presentation",
        onchange: (event) =>
          (this.choices.presentation = (event.target as HTMLSelectElement).value as Choices["presentation"]),
      },
      ...(["sequential", "side_by_side"] as const).map((one) =>
        option(one, t(`presentation_${one}`), one === this.choices.presentation),
      ),
    );
    const questions = h(
      "fieldset",
      { class: "checks" },
      h("legend", {}, t("field_questions")),
      ...QUESTIONS.map((question) => this.questionBox(question)),
    );
    return section(
      t("setup_compared"),
      ...rows,
      this.add(() => systems.push(newSystem("default"))),
      fields(field(t("field_presentation"), shown), numberField(this.choices.numbers, CLIP_SECONDS)),
      questions,
    );
  }

  private questionBox(question: string): HTMLElement {
    const box = h("input", {
      type: "checkbox",
      name: question,
      onchange: () => {
        const { questions } = this.choices;
        this.choices.questions = QUESTIONS.filter((one) => (one === question ? box.checked : questions.includes(one)));
        box.setCustomValidity(this.choices.questions.length ? "" : t("field_questions"));
      },
    });
    box.checked = this.choices.questions.includes(question);
    return h("label", {}, box, ` ${word("q", question)}`);
  }

  private candidates(): HTMLElement {
    return section(
      t("setup_compared"),
      fields(this.words("model", "field_model", { required: true, list: "models" })),
      this.numbers(CANDIDATES),
    );
  }

  private sounds(): HTMLElement {
    const { sounds } = this.choices;
    const rows = sounds.map((sound, k) => {
      const category = h(
        "select",
        { onchange: (event) => (sound.category = (event.target as HTMLSelectElement).value) },
        ...CATEGORIES.map((one) => option(one, word("category", one), one === sound.category)),
      );
      return this.listRow(
        "sound",
        sounds,
        k,
        1,
        text(sound, "path", t("field_path"), { required: true, list: "sounds" }),
        field(t("field_category"), category),
        number(sound, "start", t("field_start"), 0, 0.1),
      );
    });
    return section(
      t("setup_sounds"),
      ...rows,
      this.add(() => sounds.push(newSound())),
    );
  }

  private lists(): HTMLElement {
    const list = (id: string, names: readonly string[]) =>
      h("datalist", { id }, ...names.map((name) => h("option", { value: name })));
    return h(
      "div",
      {},
      list("models", this.known.models),
      list("folders", this.known.folders),
      list("sounds", this.known.sounds),
    );
  }

  private listRow(kind: string, list: unknown[], k: number, least: number, ...parts: HTMLElement[]): HTMLElement {
    const remove =
      list.length > least &&
      h(
        "button",
        {
          class: "button small quiet",
          type: "button",
          onclick: () => {
            list.splice(k, 1);
            this.draw();
          },
        },
        t("setup_remove"),
      );
    return h("div", { class: `fields item ${kind}` }, ...parts, remove);
  }

  private add(more: () => void): HTMLElement {
    return h(
      "button",
      {
        class: "button small",
        type: "button",
        onclick: () => {
          more();
          this.draw();
        },
      },
      t("setup_add"),
    );
  }

  private numbers(list: readonly NumberField[]): HTMLElement {
    return fields(
      ...list
        .filter(({ kind }) => !kind || kind === this.choices.kind)
        .map((one) => numberField(this.choices.numbers, one)),
    );
  }

  private words(
    name: "title" | "language" | "model",
    label: Key,
    attributes: Record<string, string | number | boolean>,
  ): HTMLElement {
    return text(this.choices, name, t(label), attributes);
  }

  private long(name: "intro" | "consent", label: Key, most: number): HTMLElement {
    const area = h("textarea", {
      rows: 3,
      maxlength: most,
      name,
      placeholder: t("setup_own_text"),
      oninput: () => (this.choices[name] = area.value),
    });
    area.value = this.choices[name];
    return field(t(label), area);
  }
}
