text = f"hello world {count}"
log.info(text)
publish(String(text))
