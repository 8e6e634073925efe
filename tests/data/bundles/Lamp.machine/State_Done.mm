//
// State_Done.mm
//
// Automatically created through MiCASE -- do not change manually!
//
Done::Done(const char *name): CLState(name, *new Done::OnEntry, *new Done::OnExit, *new Done::Internal)
{
}
