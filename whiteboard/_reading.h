/* Who reads a slot, included by _shm.c: a port declares that with its first read. */

/* The name may have been given up meanwhile; then the next read declares it. */
static void port_begin_reading(Port *self)
{
    if (!self->reads && !self->board->closed && !lwb_is_renamed(&self->slot))
        self->reads = lwb_begin_reading(&self->slot) == LWB_OK;
}

static void port_end_reading(Port *self)
{
    if (self->reads && self->board->board.fd >= 0) /* otherwise it was closed */
        lwb_end_reading(&self->slot);
    self->reads = 0;
}
