text = f"hello world {count}"
log.info(text)
say(String(text))
