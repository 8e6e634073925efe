// The breakpoints that were set in this browser, by board and machine: a robot that starts again has none.

const KEY = "llfsm.breakpoints";

export class Kept {
  constructor(board, machine) {
    this.place = `${board} ${machine}`;
  }

  list() {
    return all()[this.place] ?? [];
  }

  add(text) {
    this.store([...this.list().filter((each) => each !== text), text]);
  }

  remove(text) {
    this.store(this.list().filter((each) => each !== text));
  }

  store(texts) {
    const { [this.place]: _, ...others } = all();
    try {
      localStorage.setItem(KEY, JSON.stringify(texts.length ? { ...others, [this.place]: texts } : others));
    } catch {
      // no room, or no storage: they last as long as the machines' process
    }
  }
}

function all() {
  try {
    return JSON.parse(localStorage.getItem(KEY)) ?? {};
  } catch {
    return {};
  }
}
