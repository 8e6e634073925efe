//
// State_Suspend.mm
//
// Automatically created through MiCASE -- do not change manually!
//
Suspend::Suspend(const char *name): CLState(name, *new Suspend::OnEntry, *new Suspend::OnExit, *new Suspend::Internal)
{
}
